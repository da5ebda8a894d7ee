"""The Morton order (Z-order curve) of points, which keeps neighbours in space close in the list."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BITS = 21  # per axis, 63 in all
# Shifts and masks that spread 21 bits, with two zero bits after each.
_SPREAD = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)  # fmt: skip


def morton_order(points: NDArray) -> NDArray[np.int64]:
    """(N,) indices that sort (N, 3) finite points along the curve in their bounding box, stably (Morton, IBM technical
    report, 1966)."""
    if not len(points):
        return np.empty(0, np.int64)
    low = points.min(axis=0)
    extent = np.maximum(points.max(axis=0) / 2 - low / 2, np.finfo(np.float64).tiny)  # halves: no overflow
    cells = ((points / 2 - low / 2) / extent * (2**BITS - 1)).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, mask in _SPREAD:
        numbers = (numbers | (numbers << np.uint64(shift))) & np.uint64(mask)
    return numbers
