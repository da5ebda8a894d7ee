"""Depth-Anything-V2 files: both published layouts give the same network, and look-alikes are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
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
    transformers_4,
    write,
)
from library_networks import library_depth_anything

from gapmes.model.backbones import DepthAnythingFeatures
from gapmes.model.config import PRESETS
from gapmes.model.pretrained.depth_anything import fit_depth_anything, load_depth_anything
from gapmes.model.pretrained.files import read_tensors
from gapmes.model.weights_file import CheckpointError

LAYOUTS: dict[str, Callable[[State], State]] = {
    "transformers 5": dict,
    "transformers 4": transformers_4,
    "original": original_depth_anything,
    "original in a trainer's file": lambda s: prefixed("module.", original_depth_anything(s)),
}


def fresh() -> DepthAnythingFeatures:
    torch.manual_seed(9)
    return DepthAnythingFeatures(SMALL, frozen=True).eval()


@pytest.mark.parametrize("ending", [".safetensors", ".pth"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_network(layout: str, ending: str, tmp_path: Path) -> None:
    features, loaded = random_depth_anything(1), fresh()
    state = LAYOUTS[layout](features.model.state_dict())
    report = load_depth_anything(loaded, write(tmp_path / f"weights{ending}", state))
    assert equal(features, loaded)
    assert report.used.keys() == loaded.model.state_dict().keys()
    assert {source.partition("[")[0] for source in report.used.values()} == state.keys()
    images = torch.rand(2, 3, 64, 48, generator=torch.Generator().manual_seed(0))
    for a, b in zip(features(images), loaded(images), strict=True):
        assert torch.equal(a, b)
        assert a.std() > 0.1


def test_published_names_of_the_head_go_where_they_belong(tmp_path: Path) -> None:
    """A few correspondences written out: the fusion reverses the order of the levels."""
    state = original_depth_anything(random_depth_anything().model.state_dict())
    report, _ = fit_depth_anything(read_tensors(write(tmp_path / "a.pth", state)), fresh().model)
    expected = {
        "neck.reassemble_stage.layers.0.projection.bias": "depth_head.projects.0.bias",
        "neck.reassemble_stage.layers.3.resize.weight": "depth_head.resize_layers.3.weight",
        "neck.convs.0.weight": "depth_head.scratch.layer1_rn.weight",
        "neck.fusion_stage.layers.0.projection.bias": "depth_head.scratch.refinenet4.out_conv.bias",
        "neck.fusion_stage.layers.3.residual_layer1.convolution2.bias": (
            "depth_head.scratch.refinenet1.resConfUnit1.conv2.bias"
        ),
        "head.conv1.weight": "depth_head.scratch.output_conv1.weight",
        "head.conv3.weight": "depth_head.scratch.output_conv2.2.weight",
        "backbone.encoder.layer.3.attention.v_proj.bias": "pretrained.blocks.3.attn.qkv.bias[2/3]",
    }
    assert {name: report.used[name] for name in expected} == expected


def test_what_is_never_run_may_be_absent_and_is_named(tmp_path: Path) -> None:
    state = random_depth_anything().model.state_dict()
    dropped = [name for name in state if "fusion_stage.layers.0.residual_layer1" in name]
    for name in [*dropped, "backbone.embeddings.mask_token"]:
        del state[name]
    report = load_depth_anything(fresh(), write(tmp_path / "a.safetensors", state))
    assert report.absent.keys() == {*dropped, "backbone.embeddings.mask_token"}


def test_missing_and_unexpected_names_are_those_of_the_head_too(tmp_path: Path) -> None:
    state = original_depth_anything(random_depth_anything().model.state_dict())
    del state["depth_head.scratch.layer3_rn.weight"]
    state["depth_head.readout_projects.0.0.weight"] = torch.zeros(1)
    with pytest.raises(CheckpointError, match=r"missing \(1\): neck\.convs\.2\.weight.*depth_head\.readout_projects"):
        load_depth_anything(fresh(), write(tmp_path / "a.pth", state))


def test_an_encoder_alone_is_no_depth_anything(tmp_path: Path) -> None:
    path = write(tmp_path / "a.pth", original(random_depth_anything().vit.state_dict()))
    with pytest.raises(CheckpointError, match="without a depth head"):
        load_depth_anything(fresh(), path)


def test_the_wrong_size_names_the_preset_that_fits(tmp_path: Path) -> None:
    with torch.device("meta"):
        small = DepthAnythingFeatures(PRESETS["small"].depth_vit, frozen=True).model
        base = DepthAnythingFeatures(PRESETS["base"].depth_vit, frozen=True).model
    state = {k: torch.zeros(v.shape, dtype=torch.float16) for k, v in small.state_dict().items()}
    path = write(tmp_path / "a.pth", original_depth_anything(state))
    with pytest.raises(CheckpointError, match=r"Depth-Anything ViT-S/14 .*use preset small"):
        fit_depth_anything(read_tensors(path), base)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"depth_estimation_type": "metric"}, "depth_estimation_type = 'metric'"),
        ({"backbone_config": {"out_features": ["stage1", "stage2", "stage3"]}}, "out_features"),
        ({"head_in_index": 0}, "head_in_index = 0"),
        ({"patch_size": 16}, "patch_size = 16"),
        ({"reassemble_factors": [4, 2, 1, 1]}, "reassemble_factors = "),
        ({"backbone_config": {"num_attention_heads": 12}}, "num_attention_heads = 12"),
        ({"backbone_config": {"apply_layernorm": False}}, "apply_layernorm = False"),
        ({"backbone_config": {"layer_norm_eps": 1e-5}}, "layer_norm_eps = 1e-05"),
        ({"backbone_config": {"hidden_act": "relu"}}, "hidden_act = 'relu'"),
        ({"backbone_config": {"qkv_bias": False}}, "qkv_bias = False"),
        ({"backbone_config": {"use_swiglu_ffn": True}}, "use_swiglu_ffn = True"),
    ],
)
def test_look_alikes_are_told_by_their_configuration(config: dict[str, object], said: str, tmp_path: Path) -> None:
    write(tmp_path / "model.safetensors", random_depth_anything().model.state_dict())
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(CheckpointError, match=f"{said}.*take the relative model of the second version"):
        load_depth_anything(fresh(), tmp_path)


def test_the_configuration_that_transformers_writes_is_agreed_with(tmp_path: Path) -> None:
    features, loaded = random_depth_anything(4), fresh()
    library_depth_anything(features).save_pretrained(tmp_path)
    report = load_depth_anything(loaded, tmp_path)
    assert equal(features, loaded)
    assert report.path == "model.safetensors"
    assert (tmp_path / "config.json").is_file()
