"""A coarse plane sweep: as many planes as the parallax requires, and per pixel the one that matches best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.depth_range import DepthRange
from ..cameras.overlap import inverse_depth_steps
from .coarse_views import COARSE_SIDE, CoarseView, nearest_neighbours, warp_to
from .window_match import NOT_SEEN, correlations

F64 = NDArray[np.float64]

STEP_PX = 1.5  # of parallax between planes: a surface is at most about 0.75 px off the nearest one, in 7 px windows
MOST_PLANES = 256  # for pictures of up to CELLS px, proportionally fewer for larger ones: bounds the time
CELLS = 2 * COARSE_SIDE**2
FEWEST = 64  # lower bound of that limit, whatever the size
_BATCH = 32  # planes at a time, which bounds the memory: 1 MB per array of 64 x 64 px


def step_px(cameras: Sequence[Camera], depths: DepthRange) -> float:
    """Parallax in px between neighbouring planes: STEP_PX, or more where that would take too many planes."""
    return max(STEP_PX, swept_px(cameras, depths) / (_most(cameras) - 1))


def plane_depths(cameras: Sequence[Camera], depths: DepthRange, least: int, step: float) -> F64:
    """(D,) z-depths from near to far, uniform in inverse depth: at most `step` px of parallax apart for cameras that
    look the same way (up to twice that where they look 45 degrees apart), and at least `least` planes, within the limit
    of MOST_PLANES. `cameras` are those of the coarse views.
    """
    count = math.ceil(swept_px(cameras, depths) / step) + 1
    return inverse_depth_steps(depths.near, depths.far, min(max(count, least), _most(cameras)))


def best_planes(view: CoarseView, other: CoarseView, depths: F64) -> tuple[F64, F64]:
    """(h, w) the best correlation of `view` with `other` over planes at z-depths `depths` (D,), and (h, w) its depth;
    NOT_SEEN and the first depth where no plane is seen.
    """
    best, found = np.full(view.grey.shape, NOT_SEEN), np.full(view.grey.shape, depths[0])
    for first in range(0, len(depths), _BATCH):
        batch = depths[first : first + _BATCH]
        warped, seen = warp_to(view.grey.shape, view.camera, other, batch)
        seen &= view.kept
        some = seen.any(axis=(1, 2))
        if not some.any():
            continue
        scores = correlations(view.grey, warped[some], seen[some])
        better = scores.max(axis=0) > best
        found = np.where(better, batch[some][scores.argmax(axis=0)], found)
        best = np.where(better, scores.max(axis=0), best)
    return best, found


def swept_px(cameras: Sequence[Camera], depths: DepthRange) -> float:
    """The largest disparity in px between near and far, over all views and their nearest neighbours, for cameras that
    look the same way.

    With the camera at t = (t_x, t_y, t_z) in its neighbour's axes, the point at (u, v) from the principal point moves
    by (fx t_x - u t_z, fy t_y - v t_z) per unit of inverse depth; the largest displacement is at a corner.
    """
    largest = 0.0
    for camera, neighbour in zip(cameras, nearest_neighbours(cameras), strict=True):
        other = cameras[neighbour]
        x, y, z = ((camera.center - other.center) @ other.rotation).tolist()
        for u in (-other.cx, other.width - other.cx):
            for v in (-other.cy, other.height - other.cy):
                largest = max(largest, math.hypot(other.fx * x - u * z, other.fy * y - v * z))
    return largest * (1.0 / depths.near - 1.0 / depths.far)


def _most(cameras: Sequence[Camera]) -> int:
    cells = max(camera.width * camera.height for camera in cameras)
    return max(FEWEST, min(MOST_PLANES, MOST_PLANES * CELLS // cells))
