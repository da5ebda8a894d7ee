"""Weights files with odd indices, configurations, shapes and nests: refused in one sentence, never by a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from full_networks import miniature
from layouts import SMALL, original, random_vit, write

from gapmes.model.backbones import VitFeatures
from gapmes.model.full_trunk import FullTrunk
from gapmes.model.pretrained.dinov2 import load_vit
from gapmes.model.pretrained.files import read_tensors
from gapmes.model.pretrained.trunk import load_trunk
from gapmes.model.weights_file import CheckpointError


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"weight_map": {"a": ["m-1.safetensors"]}}, r"names the shard \['m-1.safetensors'\], which is no safetensors"),
        ({"weight_map": {"a": "m-1.safetensors", "b": 2}}, "names the shard 2, which is no safetensors"),
        ("[" * 100_000, "is no index of shards: RecursionError"),
    ],
)
def test_an_index_of_another_shape_is_refused(document: object, said: str, tmp_path: Path) -> None:
    index = tmp_path / "model.safetensors.index.json"
    index.write_text(document if isinstance(document, str) else json.dumps(document))
    with pytest.raises(CheckpointError, match=said):
        read_tensors(index)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ('{"num_attention_heads": [4, 4]}', r"states num_attention_heads = \[4, 4\], this network has 4"),
        ("[" * 100_000, "cannot be read as JSON"),
    ],
)
def test_a_configuration_of_another_shape_is_refused(config: str, said: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.safetensors", random_vit().vit.state_dict())
    (tmp_path / "config.json").write_text(config)
    with pytest.raises(CheckpointError, match=said):
        load_vit(VitFeatures(SMALL, frozen=True), path)


def test_a_misshapen_tensor_that_is_cut_is_told_with_its_whole_shape(tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    state["blocks.2.attn.qkv.weight"] = torch.zeros(100, 48)
    with pytest.raises(CheckpointError) as caught:
        load_vit(VitFeatures(SMALL, frozen=True), write(tmp_path / "a.pth", state))
    assert "misshapen (3): blocks.2.attn.qkv.weight[0/3] (100, 48) instead of (144, 48)" in str(caught.value)


def test_averaged_weights_under_another_name_are_refused_with_the_cure(tmp_path: Path) -> None:
    torch.save({"ema": {"a": torch.zeros(1)}, "epoch": 1}, tmp_path / "a.pth")
    with pytest.raises(
        CheckpointError, match=r"0 tensors and 2 other values \(ema, epoch\).*save the one state_dict that is meant"
    ):
        read_tensors(tmp_path / "a.pth")


@pytest.mark.parametrize("prefix", ["module.", "_orig_mod.depth_predictor.", "module.encoder.depth_predictor."])
def test_a_trunk_within_a_wrapper_is_found(prefix: str, tmp_path: Path) -> None:
    torch.manual_seed(1)
    trunk = FullTrunk(miniature().config)
    path = write(tmp_path / "trunk.pth", {prefix + name: value for name, value in trunk.state_dict().items()})
    loaded = FullTrunk(miniature().config)
    report = load_trunk(loaded, path)
    assert all(torch.equal(value, loaded.state_dict()[name]) for name, value in trunk.state_dict().items())
    assert report.layout.startswith("DepthSplat's" if "depth" in prefix else "UniMatch's")
    assert not report.left_out


def test_weights_beside_those_that_are_read_are_reported(tmp_path: Path) -> None:
    """Such as the mean of the weights over a training, which may be what was meant."""
    state = random_vit().vit.state_dict()
    torch.save({"state_dict": state, "ema": state, "optimizer": {}}, tmp_path / "run.pth")
    report = load_vit(VitFeatures(SMALL, frozen=True), tmp_path / "run.pth")
    assert report.summary()[-1] == "2 not read (beside the weights): ema, optimizer"


@pytest.mark.filterwarnings("ignore:.*nested tensors")
def test_nested_tensors_are_refused(tmp_path: Path) -> None:
    nested = torch.nested.nested_tensor([torch.zeros(2), torch.zeros(3)])
    torch.save({"a": torch.zeros(1), "b": nested}, tmp_path / "a.pth")
    with pytest.raises(CheckpointError, match=r"b \(1 of 2\) are sparse, nested, quantised or on the meta device"):
        read_tensors(tmp_path / "a.pth")


def test_a_file_of_torch_s_that_is_cut_short_is_told_with_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    torch.save({"a": torch.zeros(100)}, path)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(CheckpointError, match=rf"cut short, as its {path.stat().st_size} bytes lack the directory"):
        read_tensors(path)


def test_a_lack_of_memory_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another download would not help."""
    path = tmp_path / "a.pth"
    torch.save({"a": torch.zeros(100)}, path)
    monkeypatch.setattr(torch, "load", lambda *_, **__: torch.empty(2**58))
    with pytest.raises(CheckpointError, match=rf"not enough memory to read .*, of {path.stat().st_size} bytes"):
        read_tensors(path)
