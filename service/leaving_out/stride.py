"""Subsampling to one Gaussian per 2 x 2 or 4 x 4 pixels: smaller and faster, and a different model of the scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

STRIDES = (1, 2, 4)


def thinned(
    outputs: Mapping[str, NDArray], rows: NDArray[np.intp], shape: tuple[int, int, int], stride: int
) -> tuple[dict[str, NDArray], NDArray[np.intp]]:
    """Subsample a network's `outputs` for `shape` (V, H, W) to one Gaussian per square of `stride` px.

    Of the kept `rows` in a square, the one nearest to its centre remains (the last of equally near ones), with its
    scales multiplied by `stride` and the mean harmonics of all of them; an empty square stays empty. Gaussians that
    belong to no pixel stay. Returns changed outputs and the remaining rows, in ascending order.
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
    """Ascending rows of the `given` pixel nearest to the centre of each non-empty square, for `given` (V, h, s, w, s).
    Of equally near ones it is the last: where all are given, the one to the lower right of the centre."""
    stride = given.shape[2]
    off = (np.arange(stride) - (stride - 1) / 2) ** 2
    outward = stride**2 - 1 - np.argsort(np.add.outer(off, off).ravel(), kind="stable")  # symmetric: the last first
    rows = np.arange(given.size).reshape(given.shape).transpose(0, 1, 3, 2, 4).reshape(-1, stride**2)[:, outward]
    there = given.ravel()[rows]
    nearest = np.take_along_axis(rows, there.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.sort(nearest[there.any(axis=1)])
