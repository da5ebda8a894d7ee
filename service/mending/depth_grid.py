"""Depth maps upsampled to a finer pixel grid, and reduced again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


class FinerPixels(NamedTuple):
    """Along one axis: which coarse pixel each of n finer pixels lies in, and where in it."""

    coarse: NDArray[np.intp]  # (n,)
    step: F64  # (n,) offset of its centre from that of the coarse pixel, in coarse px

    @classmethod
    def of(cls, count: int, finer: int) -> FinerPixels:
        """`finer` pixels, on the span of `count`."""
        centre = (np.arange(finer) + 0.5) * count / finer
        index = centre.astype(np.intp)
        return cls(index, centre - index - 0.5)


def finer_depths(depth: NDArray, height: int, width: int) -> F64:
    """(height, width) z-depths of the pixels of a finer grid over that of `depth` (H, W), each on a plane in inverse
    depth through the coarse pixel that it lies in.

    The plane's slope along each axis is the difference to the neighbour on that side which is smaller, and 0 where the
    two differ in sign (minmod limiter) or at the border, so that no plane bridges a depth edge."""
    inverse = 1 / depth.astype(np.float64)
    rows, columns = FinerPixels.of(depth.shape[0], height), FinerPixels.of(depth.shape[1], width)
    places = np.ix_(rows.coarse, columns.coarse)
    down, right = (_slope(inverse, axis)[places] for axis in (0, 1))
    return 1 / (inverse[places] + rows.step[:, None] * down + columns.step * right)


def coarser_depths(depths: F64, k: int) -> F64:
    """(V, H, W) z-depths from (V, kH, kW): per square of k x k the reciprocal of the median inverse depth."""
    count, height, width = len(depths), depths.shape[1] // k, depths.shape[2] // k
    squares = (1 / depths).reshape(count, height, k, width, k).transpose(0, 1, 3, 2, 4)
    return 1 / np.median(squares.reshape(count, height, width, k * k), axis=3)


def _slope(values: F64, axis: int) -> F64:
    """(H, W) per pixel: the smaller of the differences to both neighbours (minmod), 0 at the border."""
    ahead = np.diff(values, axis=axis, append=np.take(values, [-1], axis))
    behind = np.diff(values, axis=axis, prepend=np.take(values, [0], axis))
    smaller = np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
    return np.where(ahead * behind > 0, smaller, 0.0)
