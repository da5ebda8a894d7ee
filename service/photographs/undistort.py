"""Photographs with lens distortion, resampled to their camera's pinhole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.distortion import Lens, pinhole_window
from .bilinear import bilinear
from .images import Photo, match_photo, resized

MAX_SIDE = 2048  # px of the result; far above the 256 to 512 px that a network sees
_STRIP = 64  # rows that are resampled at a time
HALF = 0.5  # least interpolated mask of a kept pixel


def undistorted(photo: Photo, lens: Lens, *, index: int | None = None) -> Photo:
    """The photograph resampled to the pinhole of `pinhole_window(lens)`, bilinear, with no side above MAX_SIDE.

    The photograph is matched with the lens first (`match_lens`). Masked colours have no weight. The caller resizes the
    pinhole's camera to the result: both sides are rounded to whole pixels, so that the aspects may differ by more than
    `match_photo` accepts. Raises `ImageError` where sizes do not fit and `IntrinsicsError` where there is no pinhole.
    """
    window = pinhole_window(lens)
    photo = match_lens(photo, lens, index=index)
    shrunk = _shrunk(photo.width, photo.height, lens)
    if shrunk != (photo.width, photo.height):
        photo = resized(photo, *shrunk)
    scale_x, scale_y = photo.width / lens.width, photo.height / lens.height
    width, height = _straight(photo.width, photo.height, lens)
    x = (window.left + (np.arange(width) + 0.5) * (window.width / width) - lens.cx) / lens.fx
    y = (window.top + (np.arange(height) + 0.5) * (window.height / height) - lens.cy) / lens.fy
    rgb = np.empty((height, width, 3), dtype=np.uint8)
    mask = None if photo.mask is None else np.empty((height, width), dtype=np.bool_)
    kept = photo.rgb if photo.mask is None else np.where(photo.mask[:, :, None], photo.rgb, np.uint8(0))
    for top in range(0, height, _STRIP):
        rows = slice(top, min(top + _STRIP, height))
        to_x, to_y = lens.distorted(*np.meshgrid(x, y[rows]))
        column, row = (lens.fx * to_x + lens.cx) * scale_x - 0.5, (lens.fy * to_y + lens.cy) * scale_y - 0.5
        colours = bilinear(kept, column, row)
        if photo.mask is not None and mask is not None:
            weight = bilinear(photo.mask[:, :, None], column, row)
            mask[rows] = weight[:, :, 0] >= HALF
            colours = np.where(mask[rows, :, None], colours / np.maximum(weight, HALF), 0)
        rgb[rows] = _levels(colours)
    return Photo(rgb, mask, photo.orientation)


def undistorted_size(photo: Photo, lens: Lens) -> tuple[int, int]:
    """(width, height) in px of the result of `undistorted`, for a photograph that `match_lens` has matched."""
    return _straight(*_shrunk(photo.width, photo.height, lens), lens)


def match_lens(photo: Photo, lens: Lens, *, index: int | None) -> Photo:
    """The photograph, turned upright if its lens is; it may have another resolution, as for `match_photo`. Raises
    `ImageError`."""
    raw = Camera.make(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, np.eye(4), index=index)
    return match_photo(photo, raw, index=index)[0]


def _shrunk(width: int, height: int, lens: Lens) -> tuple[int, int]:
    """(width, height) to which a photograph is reduced, so that its pinhole's picture has no side above MAX_SIDE."""
    window = pinhole_window(lens)
    shrink = min(1.0, MAX_SIDE / (max(window.width, window.height) * width / lens.width))
    return (max(1, round(width * shrink)), max(1, round(height * shrink))) if shrink < 1.0 else (width, height)


def _straight(width: int, height: int, lens: Lens) -> tuple[int, int]:
    """(width, height) of the pinhole's picture, for a photograph of this size."""
    window = pinhole_window(lens)
    return max(1, round(window.width * width / lens.width)), max(1, round(window.height * height / lens.height))


def _levels(colours: NDArray) -> NDArray[np.uint8]:
    return np.rint(np.clip(colours, 0.0, 255.0)).astype(np.uint8)
