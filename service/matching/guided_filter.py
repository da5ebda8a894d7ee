"""Edge-aware smoothing of planes, guided by a picture (guided filter, He et al. 2010)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .plane_means import plane_means

F64 = NDArray[np.float64]

RADIUS, EPSILON = 2, 1e-3  # px and variance of the guide: weaker edges are smoothed across


class GuidedFilter:
    """Filters any number of planes with one guide, whose window statistics are computed once."""

    def __init__(self, guide: F64) -> None:
        """`guide` (H, W), grey in [0, 1]."""
        self.guide = guide
        self.mean = _means(guide)
        self.variance = _means(guide**2)
        self.variance -= self.mean**2
        self.variance += EPSILON

    def of(self, plane: F64) -> F64:
        """`plane` (H, W), filtered."""
        level, slope = _means(plane), _means(self.guide * plane)
        slope -= self.mean * level
        slope /= self.variance
        level -= slope * self.mean
        found = _means(slope)
        found *= self.guide
        found += _means(level)
        return found


def _means(plane: F64) -> F64:
    """(H, W) means over windows of RADIUS."""
    return plane_means(plane, RADIUS)
