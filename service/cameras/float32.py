"""Whether numbers have been through float32, and what that may have cost them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

DIGITS, LEAST = 24, 2.0**-149  # of a float32's fraction, and the least step


def half_step(values: ArrayLike) -> float:
    """Half a float32 step at the largest of `values` where all of them are float32 numbers: each may have been rounded
    by so much. 0 where one is not, so that they never were, and where there are none."""
    wide = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore"):
        narrow = wide.astype(np.float32)
    if not wide.size or not (np.isfinite(narrow).all() and (narrow == wide).all()):
        return 0.0
    largest = float(np.abs(wide).max())
    step = math.ldexp(1.0, math.frexp(largest)[1] - DIGITS) if largest > 0 else LEAST
    return max(step, LEAST) / 2


def largest_shift(step: float, focal: float, depth: float) -> float:
    """How far, in px along any axis in the middle of a picture, moving each coordinate by `step` may move a point at
    `depth` under `focal` px: its offset has a length of sqrt(3) steps at most."""
    return math.sqrt(3) * step * focal / depth
