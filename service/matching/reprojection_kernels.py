"""Compiled loops over pixels: reprojection into another view, bilinear sampling there, and matching costs."""

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
def _around(values, column, row):
    """Of the four pixels of `values` (H, W, C) around pixel index `column`, `row`, clamped to the border: the flat
    indices of their first channels, and the weights of the right and of the lower ones."""
    height, width, channels = values.shape
    x = smaller(larger(column, 0.0), width - 1.0)
    y = smaller(larger(row, 0.0), height - 1.0)
    left, upper = np.int64(x), np.int64(y)
    right, lower = smaller(left + 1, width - 1), smaller(upper + 1, height - 1)
    above = (upper * width + left) * channels, (upper * width + right) * channels
    below = (lower * width + left) * channels, (lower * width + right) * channels
    return above, below, np.float32(x - left), np.float32(y - upper)


@kernel()
def _bilinear(values, around, channel):
    """The bilinear sample of a channel. The same bits as `bilinear.py`."""
    above, below, over, down = around
    before = np.float32(1.0) - over
    top = get(values, above[0] + channel) * before + get(values, above[1] + channel) * over
    base = get(values, below[0] + channel) * before + get(values, below[1] + channel) * over
    return top * (np.float32(1.0) - down) + base * down


@kernel()
def sample_bilinear(values, column, row, found):
    """Bilinear samples `found` (N, C) of `values` (H, W, C) at real-valued pixel indices `column` and `row` (N,),
    clamped to the border."""
    channels = values.shape[2]
    for at in range(column.size):
        around = _around(values, get(column, at), get(row, at))
        for channel in range(channels):
            put(found, at * channels + channel, _bilinear(values, around, channel))


@kernel()
def _apart(own, others, at, column, row):
    """Mean absolute difference of pixel `at` of `own` and the bilinear sample of `others` at pixel index `column`,
    `row`, clamped to the border."""
    channels = others.shape[2]
    around = _around(others, column, row)
    total = np.float32(0.0)
    for channel in range(channels):
        total += abs(_bilinear(others, around, channel) - get(own, at * channels + channel))
    return np.float64(total * (np.float32(1.0) / np.float32(channels)))


@kernel()
def compare_pixels(own, others, column, row, seen, limit, found):
    """Write `found` (H, W): the mean absolute difference of `own` (H, W, C) and bilinear samples of `others` (h, w, C)
    at pixel indices `column` and `row` (H, W), truncated at `limit`; `limit` where `seen` (H, W) is 0."""
    for at in range(found.size):
        put(found, at, limit)
        if get(seen, at) != 0:
            put(found, at, smaller(_apart(own, others, at, get(column, at), get(row, at)), limit))


@kernel()
def compare_level(own, others, rays, baseline, lens, level, limit, found):
    """Write `found` (H, W): the mean absolute difference of `own` (H, W, C) and `others` (h, w, C), truncated at
    `limit`, with all pixels at the inverse z-depth `level`. A pixel then lies along ray + level * baseline, with `rays`
    (H, W, 3) and `baseline` (3,) in the axes of the other view, whose `lens` is fx, fy, cx, cy in px. `limit` where the
    point is behind the other view or outside its picture, and where one of the four pixels around it is NaN."""
    height, width, _ = others.shape
    x_shift, y_shift, z_shift = level * get(baseline, 0), level * get(baseline, 1), level * get(baseline, 2)
    for at in range(found.size):
        apart, z = limit, get(rays, 3 * at + 2) + z_shift
        x = get(lens, 0) * ((get(rays, 3 * at) + x_shift) / z) + get(lens, 2)
        y = get(lens, 1) * ((get(rays, 3 * at + 1) + y_shift) / z) + get(lens, 3)
        if z > 0 and x > 0 and y > 0 and x < width and y < height:
            apart = smaller(_apart(own, others, at, x - 0.5, y - 0.5), limit)  # the limit for NaN
        put(found, at, apart)
