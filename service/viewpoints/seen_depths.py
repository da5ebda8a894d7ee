"""Depth range of the Gaussians that cameras see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cameras.camera import Camera
from ..gaussians import Gaussians

PERCENTILES = (1.0, 99.0)  # beyond them are outliers


def seen_depths(gaussians: Gaussians, cameras: Sequence[Camera]) -> tuple[float, float] | None:
    """The 1st and 99th percentile of the z-depths, in the cameras' units, of Gaussians whose centres project into a
    picture; None if none does.
    """
    depths = []
    for camera in cameras:
        pixels, z = camera.project(gaussians.means)
        depths.append(z[camera.shows(pixels, z)])
    seen = np.concatenate(depths) if depths else np.empty(0)
    if not len(seen):
        return None
    near, far = np.percentile(seen, PERCENTILES)
    return float(near), float(far)
