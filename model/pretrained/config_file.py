"""Checks of the `config.json` beside published weights, for what tensors do not tell: attention heads, activations, the
layers that a depth head reads."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..weights_file import CheckpointError

# Fields by which the same tensors compute something else.
VIT_FIELDS = ("num_attention_heads", "layer_norm_eps", "hidden_act", "qkv_bias", "use_swiglu_ffn")
TAP_FIELDS = ("out_features", "apply_layernorm")  # which layers a head reads, and whether normed
DEPTH_FIELDS = ("depth_estimation_type", "reassemble_factors", "head_in_index", "patch_size")


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


def compare(path: Path, stated: Mapping[str, Any], ours: object, fields: Iterable[str], cure: str) -> None:
    """Raise `CheckpointError` for the first of `fields` that the file states and `ours` has otherwise."""
    for field in fields:
        said, own = stated.get(field), getattr(ours, field)
        if isinstance(own, tuple):
            own = list(own)  # as JSON has it
        if said is None or said == own:
            continue
        raise CheckpointError(f"{path} states {field} = {said!r}, this network has {own!r}; {cure}")
