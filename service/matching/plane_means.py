"""Means over windows by compiled loops, for what comes after the network: those of `window_mean`, to the bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .plane_kernels import mean_planes
from .window_match import RADIUS

F64 = NDArray[np.float64]


def plane_means(planes: F64, radius: int = RADIUS) -> F64:
    """(..., H, W) means over windows of 2 * radius + 1 px of float64 planes, cut off at the border."""
    given = np.require(planes, np.float64, ["C", "W"]).reshape(-1, *planes.shape[-2:])
    means = np.empty_like(given)
    mean_planes(given, radius, means)
    return means.reshape(planes.shape)
