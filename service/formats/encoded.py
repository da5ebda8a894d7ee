"""The result of writers: the bytes of a file, and notes about what the format could not hold."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from .ply_write import POSITION_TOLERANCE

OPACITY_LEVELS = 255
FEW_FAINT = 0.01  # share of all Gaussians; the sample scene has 0.0004, which move its pictures by 0.2 of 1/255 at most
INTO_THE_SCENE = "move the world's origin into the scene, or write .ply"  # the cure of positions that do not fit


@dataclass(frozen=True)
class Encoded:
    """A file, and notes about losses beyond the usual rounding of its format."""

    data: bytes = field(repr=False)
    notes: tuple[str, ...] = ()


def quantized(values: NDArray, levels: int) -> tuple[NDArray[np.int64], int]:
    """Values rounded and clipped to integers from 0 to `levels`, and the number of those clipped."""
    nearest = np.rint(values)
    outside = int(((nearest < 0) | (nearest > levels)).sum())
    return np.clip(nearest, 0, levels).astype(np.int64), outside


def clamped_note(what: str, outside: int, total: int, low: float, high: float) -> list[str]:
    """A note if values were clipped to the range of the format."""
    if not outside:
        return []
    return [f"{outside} of {total} {what} are outside {low:.4g} to {high:.4g}, which is all that the format holds"]


def typical_size(gaussians: Gaussians) -> float:
    """Median over the Gaussians of the largest scale, in the caller's units, without zeros; 0 if all are 0."""
    largest = gaussians.scales.max(axis=1, initial=0.0).astype(np.float64)
    positive = largest[largest > 0]
    return float(np.median(positive)) if len(positive) else 0.0


def position_note(gaussians: Gaussians, moved: float) -> list[str]:
    """A note if rounding moves positions visibly: by `moved`, the largest change along an axis in the caller's units,
    compared with the typical size."""
    size = typical_size(gaussians)
    if moved <= POSITION_TOLERANCE * size:
        return []
    return [f"positions move by up to {moved:.3g}, a typical Gaussian measures {size:.3g}"]


def faint_note(gaussians: Gaussians) -> list[str]:
    """A note if a hundredth of the Gaussians or more are drawn, but hardly any more with their opacity in 255 levels:
    at 1/255 in a single point, below it nowhere. One of them is not seen, hundreds behind each other are."""
    opacities, least = gaussians.opacities, np.float32(1 / OPACITY_LEVELS)
    lost = int(((opacities > least) & (np.rint(opacities.astype(np.float64) * OPACITY_LEVELS) <= 1)).sum())
    if lost < FEW_FAINT * max(len(opacities), 1):
        return []
    return [
        f"{lost} of {len(opacities)} Gaussians have opacities between 1/{OPACITY_LEVELS} and 1.5/{OPACITY_LEVELS}, "
        f"which become 1/{OPACITY_LEVELS}, with which they are hardly drawn: the format holds no finer steps"
    ]


def bands_note(gaussians: Gaussians) -> list[str]:
    """A note if higher harmonics are lost, for formats with one colour per Gaussian."""
    degree = gaussians.sh_degree
    if degree == 0:
        return []
    lost = "1" if degree == 1 else f"1 to {degree}"
    return [f"harmonics of degree {lost} are left out: the format holds one colour per Gaussian"]
