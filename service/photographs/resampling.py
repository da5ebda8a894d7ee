"""Pictures at another size, without the colours that a mask leaves out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Mask = NDArray[np.bool_]
Box = tuple[float, float, float, float]

OPAQUE = 128  # alpha of 8 bits from here on keeps a pixel
LOBES = 3  # of Lanczos to each side, in pixels of the coarser grid


def resampled(
    rgb: NDArray[np.uint8], mask: Mask | None, size: tuple[int, int], box: Box
) -> tuple[NDArray[np.uint8], Mask | None]:
    """(h, w, 3) and (h, w) of a picture (H, W, 3) and its mask (H, W), True keeps, within `box` (left, top, right,
    bottom) at `size` (w, h).

    Antialiased by Lanczos. Under a mask colours are weighted by it, so that no masked colour bleeds in; the filter
    is then a Hamming window, since the negative lobes of Lanczos make such weights overshoot. A mask that leaves out
    nothing of what the filter meets, or nothing of the result, is none.
    """
    whole = Image.fromarray(rgb)
    if mask is None or mask[_met(size, box)].all():
        return np.asarray(whole.resize(size, Image.Resampling.LANCZOS, box=box)), None
    whole.putalpha(Image.fromarray(mask.astype(np.uint8) * 255))
    resized = np.asarray(whole.resize(size, Image.Resampling.HAMMING, box=box))
    kept = resized[:, :, 3] >= OPAQUE
    return np.where(kept[:, :, None], resized[:, :, :3], 0).astype(np.uint8), None if kept.all() else kept


def _met(size: tuple[int, int], box: Box) -> tuple[slice, slice]:
    """Rows and columns that Lanczos weighs where `box` is resampled to `size`: those of the box, and LOBES of the
    coarser grid's pixels to each side."""
    columns, rows = (
        slice(max(math.floor(low - reach), 0), math.ceil(high + reach))
        for low, high, reach in (
            (low, high, LOBES * max((high - low) / count, 1.0))
            for low, high, count in zip(box[:2], box[2:], size, strict=True)
        )
    )
    return rows, columns
