"""A published DepthSplat file is recognised and loaded completely; any other file is refused with its fault."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from random_checkpoint import published_layout, write_checkpoint

from gapmes.export.variant import Variant
from gapmes.model.checkpoint import shipped_checkpoint
from gapmes.model.depthsplat import checkpoint
from gapmes.model.depthsplat.checkpoint import load_depthsplat
from gapmes.model.depthsplat.config import Compatibility, DepthSplatConfig
from gapmes.model.depthsplat.network import DepthSplat
from gapmes.model.weights_file import CheckpointError, file_sha256

# what the authors' page of models says of the checkpoints, in millions; rounded there, ViT's mask token not counted
PUBLISHED_SIZES = {
    ("small", 1, 4): 37,
    ("base", 2, 4): 117,
    ("large", 2, 4): 360,
    ("small", 1, 8): 37,
    ("base", 2, 8): 117,
}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DepthSplat]:
    return write_checkpoint(tmp_path_factory.mktemp("small"))


@pytest.mark.parametrize(
    ("vit", "scales", "coarsest"), [("small", 1, 4), ("base", 2, 4), ("small", 1, 8), ("base", 2, 8)]
)
def test_every_tensor_of_a_published_file_is_used(tmp_path: Path, vit: str, scales: int, coarsest: int) -> None:
    path, network = write_checkpoint(tmp_path, vit, scales, coarsest)
    loaded, report = load_depthsplat(path)
    assert loaded.config == DepthSplatConfig(vit, scales, coarsest=coarsest)
    assert f"matched first at 1/{coarsest}, Gaussians of at most 3 units" in report.recognised
    assert not report.left_out
    assert len(report.sha256) == 64
    ours = network.state_dict()
    for name, value in loaded.state_dict().items():
        if not name.endswith("mask_token"):
            assert torch.equal(value, ours[name]), name


@pytest.mark.parametrize(("vit", "scales", "coarsest"), sorted(PUBLISHED_SIZES))
def test_the_networks_are_as_large_as_the_published_ones(vit: str, scales: int, coarsest: int) -> None:
    with torch.device("meta"):
        network = DepthSplat(DepthSplatConfig(vit, scales, coarsest=coarsest))
    millions = sum(p.numel() for p in network.parameters()) / 1e6
    assert millions == pytest.approx(PUBLISHED_SIZES[vit, scales, coarsest], rel=0.04)


def test_the_largest_gaussian_is_that_of_the_published_file(
    small: tuple[Path, DepthSplat], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No tensor gives it: the sha256 of the file determines it, or the caller."""
    path = small[0]
    assert load_depthsplat(path)[0].config.scale_max == 3
    monkeypatch.setitem(checkpoint._SCALE_MAXIMA, file_sha256(path)[:8], 0.1)
    loaded, report = load_depthsplat(path)
    assert loaded.config.scale_max == 0.1
    assert "Gaussians of at most 0.1 units" in report.recognised
    assert Variant.of(loaded.config).scale_max == 0.1
    monkeypatch.delitem(checkpoint._SCALE_MAXIMA, file_sha256(path)[:8])
    renamed = tmp_path / "depthsplat-gs-small-re10kdl3dv-448x768-randview4-10-c08188db.pth"
    renamed.symlink_to(path)
    assert load_depthsplat(renamed)[0].config.scale_max == 0.1  # a copy that was saved anew
    assert load_depthsplat(path, scale_max=0.5)[0].config.scale_max == 0.5


def test_maps_that_no_published_network_joins_are_refused(small: tuple[Path, DepthSplat], tmp_path: Path) -> None:
    tensors = published_layout(small[1])
    tensors["encoder." + checkpoint._JOINED] = torch.zeros(48, 99, 1, 1)
    torch.save({"state_dict": tensors}, tmp_path / "joined.pth")
    with pytest.raises(CheckpointError, match=r"joins 99 channels, .*208 if it matches first at 1/4 or 112 if .* 1/8"):
        load_depthsplat(tmp_path / "joined.pth")


def test_what_is_missing_unexpected_or_misshapen_is_named(small: tuple[Path, DepthSplat], tmp_path: Path) -> None:
    tensors = published_layout(small[1])
    lost = tensors.pop("encoder.gaussian_head.2.bias")
    tensors["encoder.gaussian_head.2.bais"] = lost
    tensors["encoder.gaussian_regressor.0.bias"] = torch.zeros(7)
    path = tmp_path / "wrong.pth"
    torch.save({"state_dict": tensors}, path)
    with pytest.raises(CheckpointError) as refused:
        load_depthsplat(path)
    for part in ("gaussian_head.2.bias", "gaussian_head.2.bais", "(7,) instead of (64,)", "DepthSplat small, 1 scale"):
        assert part in str(refused.value)


def test_a_checkpoint_of_depth_alone_is_refused_by_name(small: tuple[Path, DepthSplat], tmp_path: Path) -> None:
    tensors = published_layout(small[1])
    depth = {k.removeprefix("encoder."): v for k, v in tensors.items() if "depth_predictor" in k}
    torch.save({"model": depth}, tmp_path / "depth.pth")
    with pytest.raises(CheckpointError, match="predicts depth alone"):
        load_depthsplat(tmp_path / "depth.pth")


def test_the_trainers_other_state_is_named_and_left_out(small: tuple[Path, DepthSplat], tmp_path: Path) -> None:
    tensors = published_layout(small[1]) | {"losses.1.lpips.scale": torch.ones(1)}
    torch.save({"state_dict": tensors}, tmp_path / "with_losses.pth")
    report = load_depthsplat(tmp_path / "with_losses.pth")[1]
    assert list(report.left_out) == ["losses.1.lpips.scale"]


@pytest.mark.parametrize("wrapper", ["module.", "_orig_mod.", "model."])
def test_names_within_a_wrapper_are_known(wrapper: str, small: tuple[Path, DepthSplat], tmp_path: Path) -> None:
    tensors = published_layout(small[1]) | {"losses.1.lpips.scale": torch.ones(1)}
    torch.save({"state_dict": {wrapper + name: value for name, value in tensors.items()}}, tmp_path / "wrapped.pth")
    loaded, report = load_depthsplat(tmp_path / "wrapped.pth")
    assert report.layout == f"DepthSplat's, names under '{wrapper}encoder.'"
    assert list(report.left_out) == [f"{wrapper}losses.1.lpips.scale"]
    name = "gaussian_head.2.bias"
    assert torch.equal(loaded.state_dict()[name], small[1].state_dict()[name])


def test_a_file_of_another_network_is_refused(tmp_path: Path) -> None:
    torch.save({"fc.weight": torch.zeros(3, 3)}, tmp_path / "other.pth")
    with pytest.raises(CheckpointError, match=r"no checkpoint of DepthSplat.*expected is a depthsplat-gs"):
        load_depthsplat(tmp_path / "other.pth")
    with pytest.raises(CheckpointError, match="holds a checkpoint of ours, which gapmes-export takes without"):
        load_depthsplat(shipped_checkpoint("tiny"))
    torch.save({"backbone.conv1.weight": torch.zeros(1), "transformer.layers.0.a": torch.zeros(1)}, tmp_path / "u.pth")
    with pytest.raises(CheckpointError, match="it holds UniMatch's tensors, which --trunk-weights"):
        load_depthsplat(tmp_path / "u.pth")


def test_switches_are_chosen_by_name() -> None:
    assert Compatibility.named("none") == Compatibility()
    assert Compatibility.named("authors") == Compatibility.authors()
    assert Compatibility.named("tiled-mask, corner_pixels") == Compatibility(tiled_mask=True, corner_pixels=True)
    with pytest.raises(ValueError, match=r"'x' is unknown, choose none or authors alone, or of reference_intrinsics"):
        Compatibility.named("x")


def test_the_configuration_survives_json() -> None:
    config = DepthSplatConfig("base", 2, Compatibility(camera_rotations=True), 8, 0.1)
    assert DepthSplatConfig.from_json(config.to_json()) == config
    older = '{"architecture": "depthsplat", "vit": "small", "scales": 1}'
    assert DepthSplatConfig.from_json(older) == DepthSplatConfig("small", 1)
