"""Antialiased resampling of pictures, in which masked colours do not bleed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Mask = NDArray[np.bool_]
Box = tuple[float, float, float, float]

OPAQUE = 128  # alpha of 8 bits from here on keeps a pixel
LOBES = 3  # radius of Lanczos, in pixels of the coarser grid


def resampled(
    rgb: NDArray[np.uint8], mask: Mask | None, size: tuple[int, int], box: Box
) -> tuple[NDArray[np.uint8], Mask | None]:
    """`rgb` (H, W, 3) and its mask (H, W), True keeps, within `box` (left, top, right, bottom), resampled to `size` (w,
    h): (h, w, 3) and (h, w).

    The filter is Lanczos. With a mask, colours are weighted by it and the filter is a Hamming window, as the negative
    lobes of Lanczos would make such weights overshoot. The mask is None if it keeps every pixel under the filter, or
    every pixel of the result.
    """
    whole = Image.fromarray(rgb)
    if mask is None or mask[_filter_support(size, box)].all():
        return np.asarray(whole.resize(size, Image.Resampling.LANCZOS, box=box)), None
    whole.putalpha(Image.fromarray(mask.astype(np.uint8) * 255))
    resized = np.asarray(whole.resize(size, Image.Resampling.HAMMING, box=box))
    kept = resized[:, :, 3] >= OPAQUE
    return np.where(kept[:, :, None], resized[:, :, :3], 0).astype(np.uint8), None if kept.all() else kept


def _filter_support(size: tuple[int, int], box: Box) -> tuple[slice, slice]:
    """Rows and columns under the Lanczos filter where `box` is resampled to `size`: those of the box, and LOBES pixels
    of the coarser grid to each side."""
    spans = []
    for low, high, count in zip(box[:2], box[2:], size, strict=True):
        reach = LOBES * max((high - low) / count, 1.0)
        spans.append(slice(max(math.floor(low - reach), 0), math.ceil(high + reach)))
    columns, rows = spans
    return rows, columns
