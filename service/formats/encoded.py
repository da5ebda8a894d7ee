"""What every writer gives: the bytes, and a sentence for each thing that the format could not hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from .ply_write import POSITION_TOLERANCE

INTO_THE_SCENE = "move the world's origin into the scene, or write .ply"  # the cure of positions that do not fit


@dataclass(frozen=True)
class Encoded:
    """A file, and what it lost beyond the rounding that its format always has."""

    data: bytes
    notes: tuple[str, ...] = ()


def quantized(values: NDArray, levels: int) -> tuple[NDArray[np.int64], int]:
    """The nearest whole numbers from 0 to `levels`, and how many values lay more than half a step outside."""
    nearest = np.rint(values)
    outside = int(((nearest < 0) | (nearest > levels)).sum())
    return np.clip(nearest, 0, levels).astype(np.int64), outside


def clamped_note(what: str, outside: int, total: int, low: float, high: float) -> list[str]:
    """A sentence where values were beyond what the format holds."""
    if not outside:
        return []
    return [f"{outside} of {total} {what} are outside {low:.4g} to {high:.4g}, which is all that the format holds"]


def typical_size(gaussians: Gaussians) -> float:
    """The median of the largest scales, in the caller's units; 0 where there is none above 0."""
    largest = gaussians.scales.max(axis=1, initial=0.0).astype(np.float64)
    positive = largest[largest > 0]
    return float(np.median(positive)) if len(positive) else 0.0


def position_note(gaussians: Gaussians, moved: float) -> list[str]:
    """A sentence where the rounding of positions shows: `moved`, the farthest along an axis in the caller's units, is
    held against the typical size."""
    size = typical_size(gaussians)
    if moved <= POSITION_TOLERANCE * size:
        return []
    return [f"positions move by up to {moved:.3g}, a typical Gaussian measures {size:.3g}"]


def bands_note(gaussians: Gaussians) -> list[str]:
    """A sentence where the format holds one colour per Gaussian and these have more."""
    degree = gaussians.sh_degree
    if degree == 0:
        return []
    return [f"harmonics of degree 1 to {degree} are left out: the format holds one colour per Gaussian"]
