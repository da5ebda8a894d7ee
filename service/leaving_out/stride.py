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
    px: of those in `rows` the one nearest to its middle, of equally near ones the last, as many times as large and with
    the mean colour of all of them. A square without any has none. Gaussians that belong to no pixel stay.
    """
    if stride == 1:
        return dict(outputs), rows
    views, height, width = shape
    pixels = views * height * width
    squares = (views, height // stride, stride, width // stride, stride)
    given = np.zeros(pixels, np.float32)
    given[rows[rows < pixels]] = 1
    inside = _nearest_to_middle(given.reshape(squares) > 0)
    harmonics, scales = outputs["harmonics"].copy(), outputs["scales"].copy()
    total = (harmonics[:pixels] * given[:, None, None]).reshape(*squares, -1, 3).sum(axis=(2, 4))
    count = given.reshape(squares).sum(axis=(2, 4))
    at = inside // (width * height), inside // width % height // stride, inside % width // stride
    harmonics[inside] = total[at] / count[at][:, None, None]
    scales[inside] *= np.float32(stride)
    return {**outputs, "harmonics": harmonics, "scales": scales}, np.concatenate([inside, rows[rows >= pixels]])


def _nearest_to_middle(given: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Rows, in order, of the given pixel of each square that is nearest to its middle, for squares (V, h, s, w, s) with
    any. Of equally near ones it is the last: where all are given, the one to the lower right of the middle."""
    stride = given.shape[2]
    off = (np.arange(stride) - (stride - 1) / 2) ** 2
    outward = stride**2 - 1 - np.argsort(np.add.outer(off, off).ravel(), kind="stable")  # symmetric: the last first
    rows = np.arange(given.size).reshape(given.shape).transpose(0, 1, 3, 2, 4).reshape(-1, stride**2)[:, outward]
    there = given.ravel()[rows]
    nearest = np.take_along_axis(rows, there.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.sort(nearest[there.any(axis=1)])
