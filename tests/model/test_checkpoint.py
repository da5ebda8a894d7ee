"""Checkpoints: a written file is read back, and a file that does not fit is refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from small_networks import scene, tiny

from gapmes.model.checkpoint import load_checkpoint, read_metadata, save_checkpoint, shipped_checkpoint
from gapmes.model.config import PRESETS, preset
from gapmes.model.saved_tensors import save_tensors
from gapmes.model.training import run_folder
from gapmes.model.weights_file import CheckpointError


def test_round_trip_is_exact(tmp_path: Path) -> None:
    network = tiny(3)
    save_checkpoint(tmp_path / "a.safetensors", network)
    loaded = load_checkpoint(tmp_path / "a.safetensors")
    assert loaded.config == network.config
    assert all(torch.equal(a, b) for a, b in zip(network.parameters(), loaded.parameters(), strict=True))
    with torch.no_grad():
        assert torch.equal(network(*scene()).gaussians.means, loaded(*scene()).gaussians.means)
    assert [p.name for p in tmp_path.iterdir()] == ["a.safetensors"]


def test_the_same_again_gives_the_same_bytes(tmp_path: Path) -> None:
    """With several keys of metadata, whose order the package safetensors leaves to chance."""
    network, extra = tiny(3), {f"gapmes.{name}": name for name in ("step", "mean_of", "é", "b", "a")}
    for number in range(4):
        save_checkpoint(tmp_path / f"{number}.safetensors", network, extra=extra)
    written = {path.read_bytes() for path in tmp_path.iterdir()}
    assert len(written) == 1
    assert read_metadata(tmp_path / "0.safetensors").items() >= extra.items()
    assert len(list(tmp_path.iterdir())) == 4


def test_a_checkpoint_may_be_read_as_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    save_checkpoint(tmp_path / "a.safetensors", tiny())
    assert (tmp_path / "a.safetensors").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_behind_a_link_the_weights_are_replaced(tmp_path: Path) -> None:
    real, link = tmp_path / "real.safetensors", tmp_path / "served.safetensors"
    real.write_text("old")
    link.symlink_to(real)
    save_tensors(link, {"a": torch.arange(3.0)}, {})
    assert link.readlink() == real
    assert real.read_bytes() != b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [real.name, link.name]


def test_a_write_that_fails_leaves_nothing_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "taken.safetensors").mkdir()
    with pytest.raises(OSError, match=r"taken\.safetensors"):
        save_checkpoint(tmp_path / "taken.safetensors", tiny())
    assert [path.name for path in tmp_path.iterdir()] == ["taken.safetensors"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda value: value.fill_(float("nan")), r"not finite in 1 tensors \(heads\.mu\.out\.weight\)"),
        (lambda value: value.double().fill_(1e39), r"not finite in 1 tensors"),  # too large for float32
        (lambda value: (value * 127).to(torch.int8), r"1 of \d+ tensors .*\(heads\.mu\.out\.weight is int8\)"),
        (lambda value: value > 0, r"heads\.mu\.out\.weight is bool"),
        (lambda value: torch.complex(value, value), r"heads\.mu\.out\.weight is complex64"),
    ],
)
def test_numbers_that_are_no_weights_are_refused(
    damage: Callable[[torch.Tensor], torch.Tensor], said: str, tmp_path: Path
) -> None:
    network = tiny()
    state = network.state_dict()
    state["heads.mu.out.weight"] = damage(state["heads.mu.out.weight"])
    path = tmp_path / "wrong.safetensors"
    save_file(state, path, metadata={"gapmes.config": network.config.to_json()})
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


def test_a_file_that_does_not_fit_names_the_tensors(tmp_path: Path) -> None:
    network = tiny()
    state = {k: v.contiguous() for k, v in network.state_dict().items()}
    state["extra.weight"] = torch.zeros(1)
    del state["heads.mu.out.weight"]
    state["heads.mu.out.bias"] = torch.zeros(5)
    path = tmp_path / "wrong.safetensors"
    save_file(state, path, metadata={"gapmes.config": network.config.to_json()})
    with pytest.raises(CheckpointError, match=r"heads\.mu\.out\.weight.*extra\.weight.*\(5,\) instead of \(12,\)"):
        load_checkpoint(path)


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.safetensors"
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match=r"carries no gapmes\.config: it is no checkpoint of ours$"):
        load_checkpoint(path)
    with pytest.raises(CheckpointError, match=r"missing\.safetensors: no such file"):
        load_checkpoint(tmp_path / "missing.safetensors")
    path.write_bytes(b"text")
    with pytest.raises(CheckpointError, match="cannot be read as safetensors"):
        load_checkpoint(path)


def test_the_words_of_a_refusal_in_a_path_change_nothing(tmp_path: Path) -> None:
    path = tmp_path / "cannot be read as safetensors" / "net.onnx"
    path.parent.mkdir()
    path.write_bytes(b"\x08\x08\x12\x07")
    with pytest.raises(CheckpointError, match=r"net\.onnx is an exported network"):
        load_checkpoint(path)


def test_the_state_of_a_training_is_told_from_its_weights(tmp_path: Path) -> None:
    network = tiny()
    optimiser = torch.optim.AdamW(network.parameters())
    run_folder.save_state(tmp_path, {"step": 1, "sums": {}}, network, network, optimiser)
    said = r"state\.pt cannot be read as safetensors; it holds the state of a training: give weights\.safetensors"
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(tmp_path / run_folder.STATE)
    load_checkpoint(tmp_path / run_folder.WEIGHTS)


def test_an_exported_network_is_no_checkpoint(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"\x08\x08\x12\x07")
    with pytest.raises(CheckpointError, match=r"net\.onnx is an exported network, .*: give what it was made from"):
        load_checkpoint(tmp_path / "net.onnx")


# Tensors by which a network is told, and what the refusal says of them.
KINDS: list[tuple[dict[str, tuple[int, ...]], str]] = [
    ({"encoder.depth_predictor.a": (1,), "encoder.gaussian_head.b": (1,)}, "DepthSplat's.*--architecture depthsplat"),
    ({"depth_predictor.a": (1,)}, "DepthSplat's tensors for depth alone.*--trunk-weights"),
    (
        {
            "backbone.conv1.weight": (64, 3, 7, 7),
            "transformer.layers.0.a": (1,),
            "pretrained.pos_embed": (1, 1370, 384),
        },
        "DepthSplat's tensors for depth alone.*--trunk-weights",
    ),
    ({"module.encoder.depth_predictor.a": (1,)}, "DepthSplat's tensors for depth alone.*--trunk-weights"),
    ({"net.encoder.depth_predictor.a": (1,)}, r"^(?!.*it holds)"),
    ({"backbone.conv1.weight": (64, 3, 7, 7), "transformer.layers.0.a": (1,)}, "UniMatch's.*--trunk-weights"),
    (
        {"pos_embed": (1, 1370, 768), "patch_embed.proj.weight": (768, 3, 14, 14), "blocks.11.norm1.bias": (768,)},
        r"DINOv2 ViT-B/14.*--semantic-weights of a training of preset base",
    ),
    (
        {"pretrained.pos_embed": (1, 1370, 384), "pretrained.patch_embed.proj.weight": (384, 3, 14, 14)}
        | {"pretrained.blocks.11.norm1.bias": (384,), "depth_head.projects.0.bias": (48,)},
        r"Depth-Anything ViT-S/14.*--depth-weights of a training of preset small",
    ),
    (
        {"pos_embed": (1, 1370, 768), "patch_embed.proj.weight": (768, 3, 14, 14), "blocks.11.norm1.bias": (768,)}
        | {"register_tokens": (1, 4, 768)},
        "ViT-B/14 with registers.*which no preset has",
    ),
    (  # of the size of a preset whose ViTs are not loaded but trained
        {"pos_embed": (1, 257, 96), "patch_embed.proj.weight": (96, 3, 16, 16), "blocks.2.norm1.bias": (96,)},
        "which no preset has",
    ),
    ({"pos_embed": (1, 1370, 99), "patch_embed.proj.weight": (99, 3, 14, 14)}, "no preset has"),
]


@pytest.mark.parametrize(("shapes", "said"), KINDS)
@pytest.mark.parametrize("suffix", ["safetensors", "pth"])
def test_a_refused_file_is_told_by_what_it_holds(
    shapes: dict[str, tuple[int, ...]], said: str, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"other.{suffix}"
    tensors = {name: torch.zeros(shape) for name, shape in shapes.items()}
    if suffix == "pth":
        torch.save(tensors, path)
    else:
        save_file(tensors, path)
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


def test_a_preset_is_known_by_its_tensors(tmp_path: Path) -> None:
    weights = load_file(shipped_checkpoint("tiny"))
    path = tmp_path / "bare.safetensors"
    for wrapper in ("", "module."):
        save_file({wrapper + name: value for name, value in weights.items()}, path)
        with pytest.raises(CheckpointError, match="the tensors of preset tiny, whose configuration is lost"):
            load_checkpoint(path)
    other = replace(PRESETS["tiny"], experts=4)
    save_file(weights, path, metadata={"gapmes.config": other.to_json()})
    with pytest.raises(CheckpointError, match=r"its tensors are preset tiny's, its configuration has other experts$"):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"top_k": 7}, "top_k is 7, need 1 to 6"),
        ({"top_k": 0}, "top_k is 0, need 1 to 6"),
        ({"temperature": 0.0}, "temperature is 0.0, need a number of 0.001 to 1000"),
        ({"temperature": 1e-300}, "temperature is 1e-300, need a number of"),  # every weight would be NaN
        ({"temperature": "0.8"}, "temperature is '0.8', need a number of"),
        ({"temperature": True}, "temperature is True, need a number of"),
        ({"backing": "false"}, "backing is 'false', need true or false"),
        ({"without_experts": 0}, "without_experts is 0, need true or false"),
        ({"preset": "zz"}, "preset is 'zz', need one of tiny, small, base"),
        ({"preset": ["tiny"]}, r"preset is \['tiny'\], need one of"),
        ({"temperature": -1.0}, "temperature is -1.0, need"),
        ({"temperature": float("nan")}, "temperature is nan, need"),
        ({"half_channels": -4}, "half_channels is -4, need a whole number of 1 to 4096"),
        ({"quarter_channels": 64.0}, "quarter_channels is 64.0, need a whole number"),
        ({"depth_planes": True}, "depth_planes is True, need a whole number"),
        ({"depth_planes": 1}, "depth_planes is 1, need a whole number of 2 to 4096"),
        ({"experts": 129}, "experts is 129, need a whole number of 1 to 128"),  # are built one by one
        ({"cross_view_blocks": -1}, "cross_view_blocks is -1, need a whole number of 0 to"),
        ({"sh_degree": 4}, "sh_degree is 4, need at most 3"),
        ({"trunk": "heavy"}, "trunk is 'heavy', need one of light, full"),
    ],
)
def test_configurations_that_mean_nothing_are_refused(changes: dict[str, float], said: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=said):
        preset("tiny", **changes)
    config = json.loads(PRESETS["tiny"].to_json()) | changes
    path = tmp_path / "wrong.safetensors"
    save_file(load_file(shipped_checkpoint("tiny")), path, metadata={"gapmes.config": json.dumps(config)})
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", r"configuration is \[\], need an object with its fields"),
        (
            PRESETS["tiny"].to_json().replace('"depth_vit": {', '"depth_vit": null, "x": {'),
            "depth_vit is None, need",
        ),
    ],
)
def test_configurations_of_another_shape_are_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.safetensors"
    save_file(load_file(shipped_checkpoint("tiny")), path, metadata={"gapmes.config": text})
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"half_channels": 33}, "a configuration that no network has: num_channels .33. must be divisible"),
        ({"eighth_channels": 98}, "no network has: eighth_channels is 98, need a multiple of 4"),
        ({"volume_channels": 4096}, "does not fit its configuration"),  # compared without memory for it
    ],
)
def test_sizes_that_do_not_go_together_are_refused(changes: dict[str, int], said: str, tmp_path: Path) -> None:
    config = json.loads(PRESETS["tiny"].to_json()) | changes
    path = tmp_path / "wrong.safetensors"
    save_file(load_file(shipped_checkpoint("tiny")), path, metadata={"gapmes.config": json.dumps(config)})
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(path)


def test_without_experts_their_number_does_not_matter() -> None:
    assert preset("tiny", without_experts=True, top_k=7).top_k == 7


def test_why_a_file_cannot_be_read_is_said(tmp_path: Path) -> None:
    (tmp_path / "pointer.safetensors").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(CheckpointError, match="LFS"):
        load_checkpoint(tmp_path / "pointer.safetensors")
    with pytest.raises(CheckpointError, match="is a folder"):
        load_checkpoint(tmp_path)
    with pytest.raises(CheckpointError, match="/dev/null: is a device or a pipe, need a file"):
        load_checkpoint(Path("/dev/null"))


def test_shipped_weights_load_and_others_are_named() -> None:
    assert load_checkpoint(shipped_checkpoint("tiny")).config.preset == "tiny"
    with pytest.raises(CheckpointError, match="shipped: tiny"):
        shipped_checkpoint("base")
