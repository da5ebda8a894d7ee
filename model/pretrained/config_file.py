"""Checks of the `config.json` beside published weights, for what tensors do not tell: attention heads, activations, the
layers that a depth head reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..config import VitConfig
from ..depth_anything import FACTORS, DptShape
from ..vit import NORM_EPSILON
from ..weights_file import CheckpointError


def stated_of_vit(config: VitConfig) -> dict[str, Any]:
    """What a published configuration says of such a ViT, in its words: fields by which the same tensors compute
    something else."""
    return {
        "num_attention_heads": config.heads,
        "layer_norm_eps": NORM_EPSILON,
        "hidden_act": "gelu",
        "qkv_bias": True,
        "use_swiglu_ffn": False,
    }


def stated_of_tapped_vit(config: VitConfig, shape: DptShape) -> dict[str, Any]:
    """The same, and which layers a depth head reads, and whether normed."""
    stages = [f"stage{layer}" if layer else "stem" for layer in shape.layers]
    return {**stated_of_vit(config), "out_features": stages, "apply_layernorm": True}


def stated_of_depth(config: VitConfig) -> dict[str, Any]:
    """What it says of the network around the ViT."""
    return {
        "depth_estimation_type": "relative",
        "reassemble_factors": list(FACTORS),
        "head_in_index": -1,
        "patch_size": config.patch,
    }


def read_config(path: Path) -> dict[str, Any]:
    """The published configuration; raises `CheckpointError` when it is no JSON object."""
    try:
        document = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path} cannot be read as JSON: {error}") from error
    if not isinstance(document, dict):
        raise CheckpointError(f"{path} holds no JSON object")
    return document


def vit_section(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The part that describes the ViT: the whole for DINOv2, `backbone_config` for Depth-Anything."""
    nested = document.get("backbone_config")
    return nested if isinstance(nested, dict) else document


def compare(path: Path, stated: Mapping[str, Any], ours: Mapping[str, Any], cure: str) -> None:
    """Raise `CheckpointError` for the first of our fields that the file states otherwise."""
    for field, own in ours.items():
        said = stated.get(field)
        if said is not None and said != own:
            raise CheckpointError(f"{path} states {field} = {said!r}, this network has {own!r}; {cure}")
