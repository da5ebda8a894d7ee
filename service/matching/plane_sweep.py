"""A coarse plane sweep: as many planes as their parallax needs, and for every pixel the one that matches best."""

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

STEP_PX = 1.5  # of parallax from plane to plane; what lies between two is then off by about 0.75 px in windows of 7 px
MOST_PLANES = 256  # of pictures of up to CELLS px, of larger ones so many fewer: bounds the time
CELLS = 2 * COARSE_SIDE**2
FEWEST = 64  # whatever the size
_BATCH = 32  # planes at a time, which bounds the memory: 1 MB per array of 64 x 64 px


def step_px(cameras: Sequence[Camera], depths: DepthRange) -> float:
    """The parallax from plane to plane: STEP_PX, or more where there would be too many."""
    return max(STEP_PX, swept_px(cameras, depths) / (_most(cameras) - 1))


def planes(cameras: Sequence[Camera], depths: DepthRange, least: int, step: float) -> F64:
    """(D,) z-depths from near to far, `step` px of parallax apart or less where cameras look the same way (twice as far
    where they look 45 degrees apart): `least` of them or more, unless there would be too many.

    The cameras are those of the coarse views.
    """
    count = math.ceil(swept_px(cameras, depths) / step) + 1
    return inverse_depth_steps(depths.near, depths.far, min(max(count, least), _most(cameras)))


def best_planes(view: CoarseView, other: CoarseView, depths: F64) -> tuple[F64, F64]:
    """(h, w) the best correlation of `view` with `other`, seen at the planes of these depths (D,), and its depth.

    Where no plane is seen they are NOT_SEEN and the first depth.
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
    """How far a place of a picture moves between near and far in the cameras' pixels, the most of all views and their
    nearest neighbours, as if these looked the same way.

    With the camera at t = (t_x, t_y, t_z) in its neighbour's axes, what is equally far from both moves there by
    (fx t_x - u t_z, fy t_y - v t_z) per inverse depth at (u, v) from the principal point; a corner moves farthest.
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
