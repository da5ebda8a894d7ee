"""Nested arguments and results of modules: their tensors, and the same structure with every one of them changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import torch


def tensors(value: object) -> list[torch.Tensor]:
    """Those in nested tuples, mappings and dataclasses, in order."""
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, dict):
        value = list(value.values())
    elif dataclasses.is_dataclass(value):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    return [tensor for item in value for tensor in tensors(item)] if isinstance(value, list | tuple) else []


def mapped(value: object, change: Callable[[torch.Tensor], torch.Tensor]) -> object:
    """The same structure with its float tensors changed."""
    if isinstance(value, torch.Tensor):
        return change(value) if value.is_floating_point() else value
    if isinstance(value, dict):
        return {key: mapped(item, change) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(mapped(item, change) for item in value)
    if dataclasses.is_dataclass(value):
        fields = {field.name: mapped(getattr(value, field.name), change) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **fields)
    return value


def cast(value: object, dtype: torch.dtype) -> object:
    """The same structure with its float tensors in another precision."""
    return mapped(value, lambda tensor: tensor.to(dtype))


def moved_a_little(value: object, chance: torch.Generator) -> object:
    """The same structure, of float64, with every number moved by at most 2^-24 of itself, as a cast to float32 may."""
    return mapped(
        value, lambda one: one * (1 + (torch.rand(one.shape, generator=chance, dtype=one.dtype) - 0.5) * 2.0**-23)
    )
