"""A Gaussian for every second or fourth pixel in place of each: smaller and quicker, and another model of the scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

STRIDES = (1, 2, 4)


def thinned(
    outputs: Mapping[str, NDArray], rows: NDArray[np.intp], shape: tuple[int, int, int], stride: int
) -> tuple[dict[str, NDArray], NDArray[np.intp]]:
    """Outputs and rows (of those to keep) of a network for `shape` (V, H, W) with one Gaussian per square of `stride`
    px: the one at its middle, as many times as large, with the mean colour of those of the square that are in `rows`.
    A square whose middle is not in `rows` has none. Gaussians that belong to no pixel stay.
    """
    if stride == 1:
        return dict(outputs), rows
    views, height, width = shape
    pixels = views * height * width
    y, x = rows // width % height, rows % width
    middle = (y % stride == stride // 2) & (x % stride == stride // 2)
    chosen = rows[(rows >= pixels) | middle]
    inside = chosen[chosen < pixels]
    harmonics, scales = outputs["harmonics"].copy(), outputs["scales"].copy()
    given = np.zeros(pixels, np.float32)
    given[rows[rows < pixels]] = 1
    squares = (views, height // stride, stride, width // stride, stride)
    total = (harmonics[:pixels] * given[:, None, None]).reshape(*squares, -1, 3).sum(axis=(2, 4))
    count = given.reshape(squares).sum(axis=(2, 4))
    at = inside // (width * height), inside // width % height // stride, inside % width // stride
    harmonics[inside] = total[at] / count[at][:, None, None]
    scales[inside] *= np.float32(stride)
    return {**outputs, "harmonics": harmonics, "scales": scales}, chosen
