"""Bilinear interpolation of an array at real-valued pixel indices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def bilinear(values: NDArray, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray:
    """(..., C) samples of `values` (H, W, C) at pixel indices `column` and `row` (...), clamped to the border.

    Index 0 is the centre of the first pixel: a pixel position less 0.5. Weights are float32.
    """
    left, over = _parts(column, values.shape[1])
    upper, down = _parts(row, values.shape[0])
    right, lower = np.minimum(left + 1, values.shape[1] - 1), np.minimum(upper + 1, values.shape[0] - 1)
    above = values[upper, left] * (1 - over) + values[upper, right] * over
    below = values[lower, left] * (1 - over) + values[lower, right] * over
    return above * (1 - down) + below * down


def _parts(places: NDArray[np.float64], size: int) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Integer (...) and fractional (..., 1) parts of `places` (...), clipped to 0..size - 1."""
    places = np.clip(places, 0.0, size - 1.0)
    whole = places.astype(np.intp)
    return whole, (places - whole).astype(np.float32)[..., None]
