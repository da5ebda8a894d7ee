"""Co-visibility: the target pixels whose surface at least one input sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera, pixel_grid

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

TRUE_TOLERANCE = 0.02  # of the depth: half a pixel on a surface seen at 70 degrees at 128 px, far below an edge
PREDICTED_TOLERANCE = 0.05  # two predictions are compared, each with its error


def covisible(camera: Camera, depth: F32, cameras: Sequence[Camera], depths: Sequence[F32], tolerance: float) -> Mask:
    """(H, W) mask of pixels of `camera` with z-depth `depth` (H, W) that project into an input and are not occluded.

    A point is occluded when its z-depth exceeds that of the input pixel it falls into by more than the share
    `tolerance`. Background has infinite depth: a direction, which an input sees where it shows background too.
    """
    endless = np.isinf(depth).ravel()
    rays = camera.unproject(pixel_grid(depth.shape), np.where(endless, 1.0, depth.ravel().astype(np.float64)))
    rays[endless] -= camera.center
    seen = np.zeros(depth.size, dtype=bool)
    for other, surface in zip(cameras, depths, strict=True):
        pixels, z = other.project(rays + np.where(endless[:, None], other.center, 0.0))
        z = np.where(endless & (z > 0), np.inf, z)
        inside = (z > 0) & ((pixels >= 0) & (pixels < (other.width, other.height))).all(axis=1)
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.intp).T
        seen |= inside & (z <= (1 + tolerance) * surface[row, column])
    return seen.reshape(depth.shape)
