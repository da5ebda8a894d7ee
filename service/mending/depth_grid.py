"""Depth maps upsampled to a finer pixel grid, and reduced again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def finer_depths(depth: NDArray, k: int) -> F64:
    """(kH, kW) z-depths of k x k pixels in place of each of (H, W), on a plane in inverse depth through the pixel.

    The plane's slope along each axis is the difference to the neighbour on that side which is smaller, and 0 where the
    two differ in sign (minmod limiter) or at the border, so that no plane bridges a depth edge."""
    inverse = 1 / depth.astype(np.float64)
    down, right = (_slope(inverse, axis)[:, None, :, None] for axis in (0, 1))
    steps = pixel_steps(k)
    fine = inverse[:, None, :, None] + steps[:, None, None] * down + steps * right
    return 1 / fine.reshape(k * depth.shape[0], k * depth.shape[1])


def coarser_depths(depths: F64, k: int) -> F64:
    """(V, H, W) z-depths from (V, kH, kW): per square of k x k the reciprocal of the median inverse depth."""
    count, height, width = len(depths), depths.shape[1] // k, depths.shape[2] // k
    squares = (1 / depths).reshape(count, height, k, width, k).transpose(0, 1, 3, 2, 4)
    return 1 / np.median(squares.reshape(count, height, width, k * k), axis=3)


def pixel_steps(k: int) -> F64:
    """(k,) offsets in px, along one axis, from a pixel's centre to the centres of the k finer pixels in it."""
    return (np.arange(k) + 0.5) / k - 0.5


def _slope(values: F64, axis: int) -> F64:
    """(H, W) per pixel: the smaller of the differences to both neighbours (minmod), 0 at the border."""
    ahead = np.diff(values, axis=axis, append=np.take(values, [-1], axis))
    behind = np.diff(values, axis=axis, prepend=np.take(values, [0], axis))
    smaller = np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
    return np.where(ahead * behind > 0, smaller, 0.0)
