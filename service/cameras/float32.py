"""Detect numbers that were rounded to float32, and bound what the rounding cost."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

DIGITS, LEAST = 24, 2.0**-149  # bits of a float32's significand, and its smallest step


def half_step(values: ArrayLike) -> float:
    """Half a float32 step at the largest magnitude, if all `values` are exactly representable in float32: each may have
    been rounded by that much. 0 if one is not representable (nothing was rounded) or there are none."""
    wide = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore"):
        narrow = wide.astype(np.float32)
    if not wide.size or not (np.isfinite(narrow).all() and (narrow == wide).all()):
        return 0.0
    largest = float(np.abs(wide).max())
    step = math.ldexp(1.0, math.frexp(largest)[1] - DIGITS) if largest > 0 else LEAST
    return max(step, LEAST) / 2


def largest_shift(step: float, focal: float, depth: float) -> float:
    """The largest displacement in px, near the principal point, of a point at z-depth `depth` under a focal length of
    `focal` px, if each of its coordinates moves by up to `step`: an offset of length sqrt(3) step."""
    return math.sqrt(3) * step * focal / depth
