"""Loops over pixels: where another view sees them, and what its picture has there."""

from __future__ import annotations

import numpy as np

from .splat.access import get, larger, put, smaller
from .splat.kernel_cache import kernel

FARTHEST = np.finfo(np.float64).max


@kernel()
def see_pixels(depth, lens, pose, other_lens, other_pose, size, column, row, z, inside):
    """Where pixels with z-depths `depth` (H, W) stand in another view: `column`, `row` and `z` (H, W), and `inside`
    (H, W) whether in front of it and in its picture.

    Each `lens` is fx, fy, cx, cy in px; `pose` and `other_pose` (3, 4) lead from a camera's axes to the world; `size`
    is the other's width and height. As `Camera.unproject` and `Camera.project` compute it, to the bit.
    """
    width = depth.shape[1]
    for at in range(depth.size):
        x = (at % width + 0.5 - get(lens, 2)) / get(lens, 0)
        y = (at // width + 0.5 - get(lens, 3)) / get(lens, 1)
        far = get(depth, at)
        a = _along(pose, 0, x, y) * far + get(pose, 3) - get(other_pose, 3)
        b = _along(pose, 4, x, y) * far + get(pose, 7) - get(other_pose, 7)
        c = _along(pose, 8, x, y) * far + get(pose, 11) - get(other_pose, 11)
        ahead = _back(other_pose, 2, a, b, c)
        px, py = -1.0, -1.0
        if ahead > 0:
            px = _finite(get(other_lens, 0) * _back(other_pose, 0, a, b, c) / ahead + get(other_lens, 2))
            py = _finite(get(other_lens, 1) * _back(other_pose, 1, a, b, c) / ahead + get(other_lens, 3))
        put(column, at, px - 0.5)
        put(row, at, py - 0.5)
        put(z, at, ahead)
        put(inside, at, ahead > 0 and px > 0 and py > 0 and px < get(size, 0) and py < get(size, 1))


@kernel()
def _along(pose, start, x, y):
    return get(pose, start) * x + get(pose, start + 1) * y + get(pose, start + 2)


@kernel()
def _back(pose, axis, a, b, c):
    return get(pose, axis) * a + get(pose, axis + 4) * b + get(pose, axis + 8) * c


@kernel()
def _finite(place):
    """Next to the camera's own plane a point is infinitely far off the picture."""
    return -1.0 if place != place else smaller(larger(place, -FARTHEST), FARTHEST)


@kernel()
def sample_places(values, column, row, found):
    """`found` (N, C) of `values` (H, W, C) between its pixels at `column` and `row` (N,); beyond the border the
    outermost go on. As `bilinear.py` computes it, to the bit."""
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
