"""Our ViT and Depth-Anything-V2 compute what the transformers library computes with the same weights, on every grid."""

from __future__ import annotations

import pytest
import torch
from layouts import SMALL, random_depth_anything, random_vit
from library_networks import library_depth_anything, library_vit

from gapmes.model.config import PRESETS, VitConfig
from gapmes.model.depth_anything import DepthAnything
from gapmes.model.vit import Vit

# Patches, None for the grid of the position embedding, and the largest difference in float64 relative to the norm. For
# other grids the library resamples in float32. Measured: at most 2e-15, and 3e-7.
GRIDS = [(None, 1e-13), ((5, 3), 1e-6), ((2, 9), 1e-6)]


def pictures(config: VitConfig, grid: tuple[int, int] | None) -> torch.Tensor:
    rows, columns = grid or 2 * [config.image_size // config.patch]
    size = (2, 3, rows * config.patch, columns * config.patch)
    return torch.randn(size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def share(ours: torch.Tensor, theirs: torch.Tensor) -> float:
    assert ours.shape == theirs.shape
    return float((ours - theirs).norm() / theirs.norm())


@pytest.mark.parametrize(("grid", "most"), GRIDS)
@pytest.mark.parametrize("config", [SMALL, PRESETS["tiny"].semantic_vit])
@torch.no_grad()
def test_tokens_of_every_layer(config: VitConfig, grid: tuple[int, int] | None, most: float) -> None:
    features, x = random_vit(1, config).double(), pictures(config, grid)
    theirs = library_vit(features).double()(pixel_values=x, output_hidden_states=True)
    assert share(features.vit(x), theirs.last_hidden_state) < most
    tokens = features.vit.tokens(x, range(config.layers + 1))
    assert len(tokens) == len(theirs.hidden_states) == config.layers + 1
    for ours, hidden in zip(tokens, theirs.hidden_states, strict=True):
        assert share(ours, hidden) < most


@pytest.mark.parametrize(("grid", "most"), GRIDS)
@pytest.mark.parametrize("config", [SMALL, PRESETS["tiny"].depth_vit])
@torch.no_grad()
def test_inverse_depth(config: VitConfig, grid: tuple[int, int] | None, most: float) -> None:
    features, x = random_depth_anything(2, config).double(), pictures(config, grid)
    theirs = library_depth_anything(features).double()
    tokens, inverse = features.model(x)
    expected = theirs(pixel_values=x).predicted_depth.unsqueeze(1)
    assert expected.std() > 0.1 * expected.mean()
    assert share(inverse, expected) < most
    assert share(tokens, theirs.backbone(pixel_values=x).feature_maps[-1]) < most


@torch.no_grad()
def test_a_fixed_grid_changes_nothing_and_ends() -> None:
    vit, x = random_vit(3).vit.double(), pictures(SMALL, (5, 3))
    expected = vit(x)
    with vit.fixed_grid(5, 3):
        assert torch.equal(vit(x), expected)
        with pytest.raises(RuntimeError, match="size"):
            vit(pictures(SMALL, (4, 4)))
        with vit.fixed_grid(4, 4):
            vit(pictures(SMALL, (4, 4)))
        assert torch.equal(vit(x), expected)
    assert vit(pictures(SMALL, (4, 4))).shape == (2, 17, 48)


@pytest.mark.parametrize("kind", [Vit, DepthAnything])
def test_random_weights_are_small_and_a_layer_begins_close_to_the_identity(
    kind: type[Vit] | type[DepthAnything],
) -> None:
    torch.manual_seed(0)
    for name, value in kind(SMALL).named_parameters():
        if name.endswith(("norm1.weight", "norm2.weight", "layernorm.weight", "lambda1")):
            assert (value == 1).all(), name
        elif name.endswith(("bias", "mask_token")):
            assert (value == 0).all(), name
        else:
            assert float(value.detach().square().mean().sqrt()) == pytest.approx(0.02, rel=0.3), name
