"""Means over square windows: sums by doubling in torch, pooling in an exported graph, each fast where it runs."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .layers import replicate_pad


def mean_with_repeated_border(values: Tensor, radius: int) -> Tensor:
    """(n, c, h, w): means over windows of 2 * radius + 1 px, border pixels repeating outwards."""
    size = 2 * radius + 1
    padded = replicate_pad(values, radius)
    if torch.compiler.is_exporting():
        return F.avg_pool2d(F.avg_pool2d(padded, (1, size), 1), (size, 1), 1)
    return _sum(_sum(padded, 3, size), 2, size) * (1 / size**2)


def mean_inside(values: Tensor, radius: int) -> Tensor:
    """(n, c, h, w): means over what windows of 2 * radius + 1 px hold of the picture."""
    size = 2 * radius + 1
    if torch.compiler.is_exporting():
        rows = F.avg_pool2d(values, (1, size), 1, (0, radius), count_include_pad=False)
        return F.avg_pool2d(rows, (size, 1), 1, (radius, 0), count_include_pad=False)
    padding = (radius, radius, radius, radius)
    total = _sum(_sum(F.pad(values, padding), 3, size), 2, size)
    return total / _sum(_sum(F.pad(torch.ones_like(values[:1, :1]), padding), 3, size), 2, size)


def _sum(values: Tensor, dim: int, size: int) -> Tensor:
    """Sums of `size` neighbours along `dim`, which gets shorter by size - 1: of sums of 1, 2, 4, ... neighbours."""
    count = values.shape[dim] - size + 1
    total, doubled, length, start = None, values, 1, 0
    while True:
        if size & length:
            piece = doubled.narrow(dim, start, count)
            total = piece if total is None else total + piece
            start += length
        if 2 * length > size:
            assert total is not None
            return total
        shorter = doubled.shape[dim] - length
        doubled = doubled.narrow(dim, 0, shorter) + doubled.narrow(dim, length, shorter)
        length *= 2
