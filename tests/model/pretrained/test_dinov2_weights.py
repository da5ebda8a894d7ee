"""DINOv2 files: every published layout gives the same network, and every wrong file is refused with its fault."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from layouts import (
    SMALL,
    State,
    equal,
    original,
    original_depth_anything,
    prefixed,
    random_depth_anything,
    random_vit,
    transformers_4,
    write,
)
from library_networks import library_vit

from gapmes.model.backbones import VitFeatures
from gapmes.model.config import PRESETS
from gapmes.model.pretrained.dinov2 import fit_vit, load_vit
from gapmes.model.pretrained.files import read_tensors
from gapmes.model.weights_file import CheckpointError

LAYOUTS: dict[str, tuple[Callable[[State], State], str]] = {
    "transformers 5": (dict, "transformers 5"),
    "transformers 5 under dinov2.": (lambda s: prefixed("dinov2.", s), "transformers 5"),
    "transformers 4": (transformers_4, "transformers 4"),
    "transformers 4 under backbone.": (lambda s: prefixed("backbone.", transformers_4(s)), "transformers 4"),
    "original": (original, "original"),
    "original in chunks": (lambda s: original(s, chunk=2), "original"),
    "original in one chunk": (lambda s: original(s, chunk=9), "original"),
    "original under pretrained.": (lambda s: prefixed("pretrained.", original(s)), "original"),
    "original under a trainer's prefix": (lambda s: prefixed("module.encoder.pretrained.", original(s)), "original"),
}


def fresh(**changes: int) -> VitFeatures:
    torch.manual_seed(9)
    return VitFeatures(replace(SMALL, **changes), frozen=True).eval()


@pytest.mark.parametrize("ending", [".safetensors", ".pth"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_network(layout: str, ending: str, tmp_path: Path) -> None:
    features, loaded = random_vit(1), fresh()
    convert, recognised = LAYOUTS[layout]
    state = convert(features.vit.state_dict())
    report = load_vit(loaded, write(tmp_path / f"weights{ending}", state))
    assert equal(features, loaded)
    assert report.layout.startswith(recognised)
    assert report.used.keys() == loaded.vit.state_dict().keys()
    assert {source.partition("[")[0] for source in report.used.values()} == state.keys()
    assert not report.left_out
    assert not report.absent
    images = torch.rand(2, 3, 64, 80, generator=torch.Generator().manual_seed(0))
    assert torch.equal(features(images), loaded(images))


def test_the_library_s_own_reader_agrees_on_the_older_names(tmp_path: Path) -> None:
    features, loaded = random_vit(5), fresh()
    written = library_vit(features)
    written.save_pretrained(tmp_path)
    write(tmp_path / "model.safetensors", transformers_4(features.vit.state_dict()))
    assert load_vit(loaded, tmp_path).config_checked
    theirs = type(written).from_pretrained(tmp_path, local_files_only=True, use_safetensors=True)
    ours = loaded.vit.state_dict()
    assert ours.keys() == theirs.state_dict().keys()
    assert all(torch.equal(ours[name], value) for name, value in theirs.state_dict().items())


def test_the_report_is_a_document_of_where_the_weights_came_from(tmp_path: Path) -> None:
    path = write(tmp_path / "dinov2.pth", original(random_vit().vit.state_dict()))
    report = load_vit(fresh(), path)
    report.write(tmp_path / "report.json")
    document = json.loads((tmp_path / "report.json").read_text())
    assert document["path"] == "dinov2.pth"
    assert document["sha256"] == read_tensors(path).sha256
    assert document["used"]["encoder.layer.2.attention.k_proj.weight"] == "blocks.2.attn.qkv.weight[1/3]"
    assert document["missing"] == document["unexpected"] == document["misshapen"] == []
    assert document["recognised"].startswith("DINOv2-type ViT (width 48, 4 layers")


def test_half_precision_weights_become_float32(tmp_path: Path) -> None:
    features, loaded = random_vit(2), fresh()
    write(tmp_path / "half.safetensors", {k: v.half() for k, v in features.vit.state_dict().items()})
    load_vit(loaded, tmp_path)
    for a, b in zip(features.vit.parameters(), loaded.vit.parameters(), strict=True):
        assert b.dtype == torch.float32
        assert torch.equal(a.half().float(), b)


def test_a_file_without_mask_token_loads_and_says_so(tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    del state["mask_token"]
    report = load_vit(fresh(), write(tmp_path / "a.pth", state))
    assert list(report.absent) == ["embeddings.mask_token"]


def test_a_classifier_is_left_out_by_name(tmp_path: Path) -> None:
    state = prefixed("dinov2.", random_vit().vit.state_dict()) | {"classifier.weight": torch.zeros(10, 96)}
    report = load_vit(fresh(), write(tmp_path / "a.safetensors", state))
    assert report.left_out == {"classifier.weight": "linear classifier on top of the ViT"}


@pytest.mark.parametrize("convert", [dict, original_depth_anything])
def test_depth_anything_is_refused(convert: Callable[[State], State], tmp_path: Path) -> None:
    whole, loaded = random_depth_anything(3), fresh()
    path = write(tmp_path / "depth.pth", convert(whole.model.state_dict()))
    before = {k: v.clone() for k, v in loaded.vit.state_dict().items()}
    with pytest.raises(CheckpointError, match=r"Depth-Anything.*facebook/dinov2-base"):
        load_vit(loaded, path)
    assert all(torch.equal(v, before[k]) for k, v in loaded.vit.state_dict().items())


def test_missing_unexpected_and_misshapen_tensors_are_named_with_counts(tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    del state["norm.weight"]
    del state["blocks.1.attn.qkv.bias"]
    state["blocks.0.extra"] = torch.zeros(1)
    state["blocks.3.mlp.fc1.bias"] = torch.zeros(7)
    state["blocks.2.attn.qkv.weight"] = torch.zeros(100, 48)
    loaded = fresh()
    before = {k: v.clone() for k, v in loaded.vit.state_dict().items()}
    with pytest.raises(CheckpointError) as caught:
        load_vit(loaded, write(tmp_path / "broken.pth", state))
    said = str(caught.value)
    assert "broken.pth does not fit" in said
    assert "missing (4): encoder.layer.1.attention.k_proj.bias" in said
    assert "layernorm.weight" in said
    assert "unexpected (1): blocks.0.extra" in said
    assert "misshapen (4)" in said
    assert "blocks.3.mlp.fc1.bias (7,) instead of (96,)" in said
    assert "cut short" in said
    assert all(torch.equal(v, before[k]) for k, v in loaded.vit.state_dict().items())


def test_two_sources_for_one_tensor_are_refused(tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    state["blocks.0.1.norm1.weight"] = state["blocks.1.norm1.weight"]
    with pytest.raises(CheckpointError, match=r"unexpected \(1\): blocks\.1\.norm1\.weight \(already given by"):
        load_vit(fresh(), write(tmp_path / "twice.pth", state))


@pytest.mark.parametrize(("held", "asked"), [("base", "small"), ("small", "base")])
def test_the_wrong_size_names_the_preset_that_fits(held: str, asked: str, tmp_path: Path) -> None:
    with torch.device("meta"):
        state = original(VitFeatures(PRESETS[held].semantic_vit, frozen=True).vit.state_dict())
    path = write(tmp_path / "vit.pth", {k: torch.zeros(v.shape, dtype=torch.float16) for k, v in state.items()})
    with torch.device("meta"):
        features = VitFeatures(PRESETS[asked].semantic_vit, frozen=True)
    letter = held[0].upper()
    with pytest.raises(CheckpointError, match=rf"These are the tensors of DINOv2 ViT-{letter}/14 .*use preset {held}"):
        fit_vit(read_tensors(path), features.vit)


def test_other_depths_and_grids_are_hinted_at(tmp_path: Path) -> None:
    path = write(tmp_path / "a.safetensors", random_vit().vit.state_dict())
    with pytest.raises(CheckpointError, match=r"unexpected \(18\).*no preset has that size"):
        load_vit(fresh(layers=3), path)
    with pytest.raises(CheckpointError, match=r"position_embeddings \(1, 17, 48\).*image_size=56"):
        load_vit(fresh(image_size=70), path)


@pytest.mark.parametrize("name", ["register_tokens", "embeddings.register_tokens"])
def test_register_tokens_are_refused_with_the_file_to_take(name: str, tmp_path: Path) -> None:
    state = random_vit().vit.state_dict()
    state = (state if name.startswith("emb") else original(state)) | {name: torch.zeros(1, 4, 48)}
    with pytest.raises(CheckpointError, match=r"register tokens.*dinov2_vitb14_pretrain\.pth"):
        load_vit(fresh(), write(tmp_path / "reg.pth", state))


@pytest.mark.parametrize("name", ["blocks.0.mlp.w12.weight", "encoder.layer.0.mlp.weights_in.weight"])
def test_swiglu_is_refused_by_name(name: str, tmp_path: Path) -> None:
    state = random_vit().vit.state_dict()
    state = (state if name.startswith("enc") else original(state)) | {name: torch.zeros(4, 48)}
    with pytest.raises(CheckpointError, match="SwiGLU"):
        load_vit(fresh(), write(tmp_path / "giant.pth", state))


def test_a_file_of_something_else_or_of_two_networks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no ViT of DINOv2's kind.*layer1\.0\.conv1"):
        load_vit(fresh(), write(tmp_path / "resnet.pth", {"layer1.0.conv1.weight": torch.zeros(3)}))
    state = original(random_vit(1).vit.state_dict())
    both = prefixed("student.", original(random_vit(2).vit.state_dict())) | prefixed("teacher.", state)
    file = read_tensors(write(tmp_path / "both.pth", both))
    with pytest.raises(CheckpointError, match=r"2 ViTs, under 'student\.', 'teacher\.'"):
        fit_vit(file, fresh().vit)


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    state["norm.bias"][3] = float("nan")
    with pytest.raises(CheckpointError, match=r"not finite in 1 tensors \(norm\.bias\)"):
        load_vit(fresh(), write(tmp_path / "nan.pth", state))


@pytest.mark.parametrize("kind", [torch.int8, torch.bool, torch.complex64])
def test_other_numbers_than_floating_point_are_refused(kind: torch.dtype, tmp_path: Path) -> None:
    state = original(random_vit().vit.state_dict())
    state["norm.bias"] = state["norm.bias"].to(kind)
    with pytest.raises(CheckpointError, match=rf"1 of \d+ tensors .*\(norm\.bias is {str(kind)[6:]}\)"):
        load_vit(fresh(), write(tmp_path / "odd.pth", state))


def test_a_configuration_that_computes_something_else_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "model.safetensors", random_vit().vit.state_dict())
    (tmp_path / "config.json").write_text(json.dumps({"num_attention_heads": 6}))
    with pytest.raises(CheckpointError, match="num_attention_heads = 6, this network has 4"):
        load_vit(fresh(), tmp_path)
    (tmp_path / "config.json").write_text("[]")
    with pytest.raises(CheckpointError, match="no JSON object"):
        load_vit(fresh(), tmp_path)
