"""Box filter by compiled loops, for use after the network; the same bits as `window_mean`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .plane_kernels import mean_planes
from .window_match import RADIUS

F64 = NDArray[np.float64]


def plane_means(planes: F64, radius: int = RADIUS) -> F64:
    """(..., H, W) means of float64 planes over square windows of 2 * radius + 1 px, clipped at the border."""
    given = np.require(planes, np.float64, ["C", "W"]).reshape(-1, *planes.shape[-2:])
    means = np.empty_like(given)
    mean_planes(given, radius, means)
    return means.reshape(planes.shape)
