"""Photographs through a lens that bends rays, resampled to the pinhole that their camera is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.distortion import Lens, pinhole_window
from .bilinear import bilinear
from .images import Photo, match_photo, resized

MAX_SIDE = 2048  # px of the result; far above the 256 to 512 px that a network sees
_STRIP = 64  # rows that are resampled at a time
HALF = 0.5  # of a pixel's weight in the mask keeps it


def undistorted(photo: Photo, lens: Lens, *, index: int | None = None) -> Photo:
    """What the pinhole of `pinhole_window(lens)` shows of the photograph, bilinear, at its resolution or below.

    The photograph is matched with the lens as by `match_lens`. Under a mask colours are weighted by it. Raises
    `ImageError` where sizes do not fit and `IntrinsicsError` where there is no such pinhole.
    """
    window = pinhole_window(lens)
    photo = match_lens(photo, lens, index=index)
    shrink = min(1.0, MAX_SIDE / (max(window.width, window.height) * photo.width / lens.width))
    if shrink < 1.0:
        photo = resized(photo, max(1, round(photo.width * shrink)), max(1, round(photo.height * shrink)))
    scale_x, scale_y = photo.width / lens.width, photo.height / lens.height
    width, height = max(1, round(window.width * scale_x)), max(1, round(window.height * scale_y))
    x = (window.left + (np.arange(width) + 0.5) * (window.width / width) - lens.cx) / lens.fx
    y = (window.top + (np.arange(height) + 0.5) * (window.height / height) - lens.cy) / lens.fy
    rgb = np.empty((height, width, 3), dtype=np.uint8)
    mask = None if photo.mask is None else np.empty((height, width), dtype=np.bool_)
    for top in range(0, height, _STRIP):
        rows = slice(top, min(top + _STRIP, height))
        to_x, to_y = lens.bent(*np.meshgrid(x, y[rows]))
        column, row = (lens.fx * to_x + lens.cx) * scale_x - 0.5, (lens.fy * to_y + lens.cy) * scale_y - 0.5
        if photo.mask is None or mask is None:
            rgb[rows] = _levels(bilinear(photo.rgb, column, row))
            continue
        weights = photo.mask.astype(np.float32)[:, :, None]
        weight = bilinear(weights, column, row)
        mask[rows] = weight[:, :, 0] >= HALF
        colours = bilinear(photo.rgb * weights, column, row) / np.maximum(weight, HALF)
        rgb[rows] = np.where(mask[rows, :, None], _levels(colours), 0)
    return Photo(rgb, mask, photo.orientation)


def match_lens(photo: Photo, lens: Lens, *, index: int | None = None) -> Photo:
    """The photograph on the pixel grid of its lens: it may have another resolution or be turned,
    as for `match_photo`. Raises `ImageError`."""
    raw = Camera.make(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, np.eye(4), index=index)
    return match_photo(photo, raw, index=index)[0]


def _levels(colours: NDArray) -> NDArray[np.uint8]:
    return np.rint(np.clip(colours, 0.0, 255.0)).astype(np.uint8)
