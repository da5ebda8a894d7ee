"""Between which depths the Gaussians lie that some cameras see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cameras.camera import Camera
from ..gaussians import Gaussians

PERCENTILES = (1.0, 99.0)  # what lies outside are strays


def seen_depths(gaussians: Gaussians, cameras: Sequence[Camera]) -> tuple[float, float] | None:
    """z-depths, in the cameras' units, between which 98 % of what the cameras see lies; None where they see nothing.

    A Gaussian is seen by each camera in whose picture its centre lies.
    """
    depths = []
    for camera in cameras:
        pixels, z = camera.project(gaussians.means)
        inside = (pixels >= 0) & (pixels < (camera.width, camera.height))  # NaN behind the camera compares as False
        depths.append(z[inside.all(axis=1) & (z > 0)])
    seen = np.concatenate(depths) if depths else np.empty(0)
    if not len(seen):
        return None
    near, far = np.percentile(seen, PERCENTILES)
    return float(near), float(far)
