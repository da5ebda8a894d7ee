"""Depth-Anything's cue: the published head, made independent of scale and shift, on the cells' grid, and as an ONNX
graph."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
import torch.nn.functional as F
from layouts import SMALL, random_depth_anything
from library_networks import library_depth_anything
from torch.export import Dim

from gapmes.model.backbones import DepthAnythingFeatures, VitFeatures, without_scale_and_shift
from gapmes.model.config import PRESETS, VitConfig
from gapmes.model.depth_anything import DptShape
from gapmes.model.vit import normalised_for_vit

HEIGHT, WIDTH = 64, 96


def images(count: int = 2, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(
    ("vit", "layers", "levels", "fusion"),
    [
        (PRESETS["small"].depth_vit, (3, 6, 9, 12), (48, 96, 192, 384), 64),
        (PRESETS["base"].depth_vit, (3, 6, 9, 12), (96, 192, 384, 768), 128),
        (VitConfig(1024, 24, 16, 14, 4, 518), (5, 12, 18, 24), (256, 512, 1024, 1024), 256),
        (PRESETS["tiny"].depth_vit, (0, 1, 2, 3), (12, 24, 48, 96), 16),
    ],
)
def test_the_head_has_the_published_shape(
    vit: VitConfig, layers: tuple[int, ...], levels: tuple[int, ...], fusion: int
) -> None:
    assert DptShape.of(vit) == DptShape(layers, levels, fusion)  # type: ignore[arg-type]


def test_a_vit_of_three_layers_is_enough() -> None:
    features, inverse = random_depth_anything(0, PRESETS["tiny"].depth_vit)(images())
    assert features.shape == (2, 96, HEIGHT // 16, WIDTH // 16)
    assert inverse.shape == (2, 1, HEIGHT // 4, WIDTH // 4)
    assert inverse.std() > 0.9


def test_a_vit_with_too_few_layers_is_refused() -> None:
    with pytest.raises(ValueError, match="reads four layers of a ViT, this one has 2"):
        DptShape.of(VitConfig(48, 2, 4, 14, 2, 56))


@pytest.mark.parametrize(("preset", "millions"), [("small", 24.8), ("base", 97.5)])
def test_the_presets_sizes_have_as_many_parameters_as_published(preset: str, millions: float) -> None:
    with torch.device("meta"):
        features = DepthAnythingFeatures(PRESETS[preset].depth_vit, frozen=True)
    assert sum(p.numel() for p in features.parameters()) / 1e6 == pytest.approx(millions, abs=0.05)


def test_features_are_those_of_the_same_encoder_alone() -> None:
    whole, alone = random_depth_anything(1), VitFeatures(SMALL, frozen=True).eval()
    alone.vit.load_state_dict(whole.vit.state_dict())
    features, inverse = whole(images())
    assert torch.equal(features, alone(images()))
    assert inverse.shape == (2, 1, HEIGHT // 4, WIDTH // 4)


def test_the_cue_is_the_published_depth_averaged_over_each_cell() -> None:
    features = random_depth_anything(2)
    x = normalised_for_vit(images())
    x = F.interpolate(x, size=(HEIGHT // 16 * 14, WIDTH // 16 * 14), mode="bilinear")
    with torch.no_grad():
        published = library_depth_anything(features)(pixel_values=x).predicted_depth.unsqueeze(1)
        cue = features(images())[1]
    assert published.std() > 1
    # Every pixel as 2 x 2, of which a cell covers 7 x 7 whole ones.
    cells = F.avg_pool2d(published.repeat_interleave(2, -1).repeat_interleave(2, -2), 7)
    torch.testing.assert_close(cue, without_scale_and_shift(cells), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-30, 0.0), (1e30, 0.0), (7.0, 3.0), (1e-3, -1e-3)])
def test_scale_and_shift_of_the_depth_do_not_tell(scale: float, shift: float) -> None:
    inverse = torch.rand(3, 1, 16, 24, generator=torch.Generator().manual_seed(3))
    cue = without_scale_and_shift(inverse * scale + shift)
    torch.testing.assert_close(cue, without_scale_and_shift(inverse), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(cue.mean((-2, -1)), torch.zeros(3, 1), rtol=0, atol=1e-5)
    torch.testing.assert_close(cue.std((-2, -1), unbiased=False), torch.ones(3, 1), rtol=1e-4, atol=0)


@pytest.mark.parametrize("value", [0.0, 1e-38, 0.1, 3.0, 1e38])
def test_a_flat_depth_is_no_cue(value: float) -> None:
    assert torch.equal(without_scale_and_shift(torch.full((2, 1, 8, 8), value)), torch.zeros(2, 1, 8, 8))


def test_rounding_on_a_flat_depth_is_not_made_a_cue() -> None:
    noise = 1 + 1e-7 * torch.randn(1, 1, 32, 32, generator=torch.Generator().manual_seed(4))
    assert without_scale_and_shift(noise).abs().max() < 0.02


def test_images_do_not_mix() -> None:
    features = random_depth_anything(5)
    together = features(images(3))
    for i in range(3):
        for a, b in zip(together, features(images(3)[i : i + 1]), strict=True):
            torch.testing.assert_close(a[i : i + 1], b, rtol=1e-4, atol=1e-4)


def test_frozen_weights_take_no_gradient_and_others_do() -> None:
    frozen = DepthAnythingFeatures(SMALL, frozen=True)
    assert not any(p.requires_grad for p in frozen.parameters())
    assert not any(x.requires_grad for x in frozen(images().requires_grad_()))
    trained = DepthAnythingFeatures(SMALL, frozen=False)
    features, inverse = trained(images())
    (features.square().mean() + inverse.square().mean()).backward()
    without = {name for name, p in trained.named_parameters() if p.requires_grad and p.grad is None}
    assert all("fusion_stage.layers.0.residual_layer1" in name for name in without)  # never run


def test_the_graph_gives_the_same_at_every_number_of_views(tmp_path: Path) -> None:
    features = random_depth_anything(6)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with torch.no_grad(), features.vit.fixed_grid(HEIGHT // 16, WIDTH // 16), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            features,
            (images(3),),
            dynamo=True,
            input_names=["images"],
            output_names=["features", "inverse"],
            dynamic_shapes={"images": {0: Dim("V", min=2, max=6)}},
            opset_version=20,
            verbose=False,
        )
    assert program is not None
    program.save(tmp_path / "depth.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "depth.onnx", providers=["CPUExecutionProvider"])
    for count in (2, 3, 4, 6):
        x = images(count, seed=count)
        with torch.no_grad():
            expected = features(x)
        for ours, theirs in zip(session.run(None, {"images": x.numpy()}), expected, strict=True):
            assert ours.shape == tuple(theirs.shape)
            assert np.linalg.norm(ours - theirs.numpy()) < 1e-4 * np.linalg.norm(theirs.numpy())
