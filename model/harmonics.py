"""Rotation of spherical-harmonics coefficients in torch, by the same direct recursion as the service's."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from gapmes.service.harmonics import BAND_1_AXES, basis_functions, next_band


def rotate_bands(
    coefficients: Tensor, rotation: Tensor, *, axes: tuple[int, ...] = BAND_1_AXES, signed: bool = True
) -> Tensor:
    """Turn bands 1 and up: coefficients (n, M, K - 1, 3) without DC, rotation (n, 3, 3), one for each of n cameras.

    `axes` of band 1 and whether odd orders are `signed` say another basis than that of the file format.

    The function that comes out has at `rotation @ d` the value that went in at d. Every entry of a band's matrix is a
    polynomial of the rotation's entries (Ivanic and Ruedenberg 1996), so the graph holds only products and sums.
    """
    degree = math.isqrt(coefficients.shape[2] + 1) - 1
    first = np.empty((3, 3), dtype=object)
    for i, row in enumerate(axes):
        for j, column in enumerate(axes):
            first[i, j] = rotation[:, row, column]
    turned, previous, start = [], first, 0
    for band in range(1, degree + 1):
        entries = first if band == 1 else next_band(first, previous, band)
        previous, size = entries, 2 * band + 1
        signs = [(-1.0) ** m if signed else 1.0 for m in range(-band, band + 1)]
        rows = [torch.stack([entries[i, j] * (signs[i] * signs[j]) for j in range(size)], dim=-1) for i in range(size)]
        matrix = torch.stack(rows, dim=-2)  # (n, size, size)
        turned.append(matrix.unsqueeze(1) @ coefficients[:, :, start : start + size])
        start += size
    return torch.cat(turned, dim=2)


def evaluate(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Colours 0.5 + sum of basis * coefficient, not clamped: coefficients (..., K, 3), unit directions (..., 3).

    Differentiable in both.
    """
    degree = math.isqrt(coefficients.shape[-2]) - 1
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    basis = torch.stack(basis_functions(x, y, z, degree), dim=-1)
    return 0.5 + (basis.unsqueeze(-1) * coefficients).sum(-2)
