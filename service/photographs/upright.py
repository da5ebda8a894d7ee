"""EXIF orientation, applied to pixels."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", bound=np.generic)

ON_ITS_SIDE = (5, 6, 7, 8)  # orientations that swap width and height
SAME_SIZE = (2, 3, 4)  # those that do not: mirrored, turned by 180 degrees, and both; 1 is as stored


def upright(pixels: NDArray[T], orientation: int) -> NDArray[T]:
    """(H, W, ...) as stored -> (H', W', ...) as displayed: transposed for EXIF 5 to 8, then flipped as the tag says."""
    if orientation in ON_ITS_SIDE:
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)
