"""Checks of weights: floating point, and finite."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from .weights_file import CheckpointError, some


def refuse_other_kinds(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Raises `CheckpointError` for integers, booleans, complex and packed 4-bit numbers, naming tensors and dtypes."""
    odd = [
        f"{name} is {_kind(value)}"
        for name, value in tensors.items()
        if not value.is_floating_point() or _kind(value).startswith("float4")  # two in a byte: torch converts none
    ]
    if odd:
        raise CheckpointError(
            f"{path} has {len(odd)} of {len(tensors)} tensors in other numbers than floating point "
            f"({some(odd)}); it was quantised or saved wrongly: take one with float weights"
        )


def refuse_non_finite(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Raises `CheckpointError` for nan and infinity, naming tensors."""
    bad = [name for name, value in tensors.items() if not bool(torch.isfinite(value).all())]
    if bad:
        raise CheckpointError(
            f"{path} has numbers that are not finite in {len(bad)} tensors ({some(bad)}); "
            "it is damaged or was saved from a diverged run: take another file"
        )


def _kind(value: Tensor) -> str:
    return str(value.dtype).removeprefix("torch.")
