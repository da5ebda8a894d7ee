"""Compiled loops over pixels: reprojection into another view, and bilinear sampling there."""

from __future__ import annotations

import numpy as np

from ..splat.access import get, larger, put, smaller
from ..splat.kernel_cache import kernel

FARTHEST = np.finfo(np.float64).max


@kernel()
def reproject_pixels(depth, lens, pose, other_lens, other_pose, size, column, row, z, inside):
    """Reproject pixels with z-depths `depth` (H, W) into another view: writes `column`, `row` (pixel indices), `z` and
    `inside` (in front of it and within its picture), each (H, W).

    `lens` and `other_lens` are fx, fy, cx, cy in px; `pose` and `other_pose` (3, 4) are camera-to-world; `size` is the
    other view's width and height. The same bits as `Camera.unproject` and `Camera.project`.
    """
    height, width = depth.shape
    across, down, middle_x, middle_y = _four(lens)
    other_across, other_down, other_x, other_y = _four(other_lens)
    p, q = _twelve(pose), _twelve(other_pose)
    right, bottom = get(size, 0), get(size, 1)
    for line in range(height):  # all in vectors: nothing is read but the depth, and nothing branches
        y = (line + 0.5 - middle_y) / down
        for place in range(width):
            at = line * width + place
            x = (place + 0.5 - middle_x) / across
            far = get(depth, at)
            a = (p[0] * x + p[1] * y + p[2]) * far + p[3] - q[3]
            b = (p[4] * x + p[5] * y + p[6]) * far + p[7] - q[7]
            c = (p[8] * x + p[9] * y + p[10]) * far + p[11] - q[11]
            ahead = q[2] * a + q[6] * b + q[10] * c
            px = _finite(other_across * (q[0] * a + q[4] * b + q[8] * c) / ahead + other_x)
            py = _finite(other_down * (q[1] * a + q[5] * b + q[9] * c) / ahead + other_y)
            px, py = (px if ahead > 0 else -1.0), (py if ahead > 0 else -1.0)
            put(column, at, px - 0.5)
            put(row, at, py - 0.5)
            put(z, at, ahead)
            put(inside, at, (ahead > 0) & (px > 0) & (py > 0) & (px < right) & (py < bottom))


@kernel()
def _four(lens):
    return get(lens, 0), get(lens, 1), get(lens, 2), get(lens, 3)


@kernel()
def _twelve(pose):
    """The entries of a (3, 4) pose, row by row."""
    return (
        get(pose, 0), get(pose, 1), get(pose, 2), get(pose, 3),
        get(pose, 4), get(pose, 5), get(pose, 6), get(pose, 7),
        get(pose, 8), get(pose, 9), get(pose, 10), get(pose, 11),
    )  # fmt: skip


@kernel()
def _finite(place):
    """A pixel position, clamped to the finite numbers, which it leaves at z next to 0; -1, off the picture, for NaN."""
    return -1.0 if place != place else smaller(larger(place, -FARTHEST), FARTHEST)


@kernel()
def sample_bilinear(values, column, row, found):
    """Bilinear samples `found` (N, C) of `values` (H, W, C) at real-valued pixel indices `column` and `row` (N,),
    clamped to the border. The same bits as `bilinear.py`."""
    height, width, channels = values.shape
    for at in range(column.size):
        x = smaller(larger(get(column, at), 0.0), width - 1.0)
        y = smaller(larger(get(row, at), 0.0), height - 1.0)
        left, upper = np.int64(x), np.int64(y)
        over, down = np.float32(x - left), np.float32(y - upper)
        before, above = np.float32(1.0) - over, np.float32(1.0) - down
        right, lower = smaller(left + 1, width - 1), smaller(upper + 1, height - 1)
        for channel in range(channels):
            corners = (upper * width + left) * channels + channel, (upper * width + right) * channels + channel
            below = (lower * width + left) * channels + channel, (lower * width + right) * channels + channel
            top = get(values, corners[0]) * before + get(values, corners[1]) * over
            base = get(values, below[0]) * before + get(values, below[1]) * over
            put(found, at * channels + channel, top * above + base * down)
