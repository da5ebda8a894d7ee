"""Compiled loops over pixels that would take numpy many passes: box filter, recursive edge-aware filter."""

from __future__ import annotations

import numpy as np

from ..splat.access import get, larger, put, smaller
from ..splat.kernel_cache import kernel

ROWS = 4  # as many as `_sum_along` has sums


@kernel()
def mean_planes(planes, radius, means):
    """Write `means` (D, H, W) of `planes` (D, H, W) over windows of 2 * radius + 1 px, clipped at the border; by
    running sums down the columns, then along the rows. ROWS rows are summed together, so that their chains of additions
    overlap."""
    height, width = planes.shape[1], planes.shape[2]
    sums, along = np.zeros((height + 1) * width), np.zeros(ROWS * (width + 1))
    rows = np.zeros(ROWS * width)
    inner = smaller(radius, width)
    for plane in range(planes.shape[0]):
        start = plane * height * width
        for at in range(height * width):
            put(sums, at + width, get(sums, at) + get(planes, start + at))
        for first in range(0, height, ROWS):
            count = smaller(ROWS, height - first)
            for row in range(count):
                y = first + row
                low, high = larger(y - radius, 0) * width, smaller(y + radius + 1, height) * width
                size = np.float64((high - low) // width)
                for x in range(width):
                    put(rows, row * width + x, (get(sums, high + x) - get(sums, low + x)) / size)
            _sum_along(rows, width, along)
            for row in range(count):
                begin, to, size = row * (width + 1), start + (first + row) * width, np.float64(2 * radius + 1)
                for x in range(inner):
                    put(means, to + x, _cut_off(along, begin, x, radius, width))
                for x in range(inner, width - radius):
                    put(means, to + x, (get(along, begin + x + radius + 1) - get(along, begin + x - radius)) / size)
                for x in range(larger(width - radius, inner), width):
                    put(means, to + x, _cut_off(along, begin, x, radius, width))


@kernel()
def _sum_along(rows, width, along):
    """Write running sums `along` (ROWS, width + 1), each starting with 0, of `rows` (ROWS, width)."""
    one = two = three = four = 0.0
    for x in range(width):
        one += get(rows, x)
        two += get(rows, width + x)
        three += get(rows, 2 * width + x)
        four += get(rows, 3 * width + x)
        put(along, x + 1, one)
        put(along, width + x + 2, two)
        put(along, 2 * width + x + 3, three)
        put(along, 3 * width + x + 4, four)


@kernel()
def _cut_off(along, begin, x, radius, width):
    """The mean around column x of the row whose running sums start at `begin`, over a window clipped at the border."""
    low, high = larger(x - radius, 0), smaller(x + radius + 1, width)
    return (get(along, begin + high) - get(along, begin + low)) / (high - low)


@kernel()
def spread_along_rows(planes, weights, sums):
    """Write weighted `sums` (K, H, W) of `planes` (K, H, W) along each row, by a recursive filter in both directions:
    a weight is the product of the step factors `weights` (H, W - 1) between the two pixels."""
    height, width = planes.shape[1], planes.shape[2]
    for plane_row in range(planes.shape[0] * height):
        start, edge = plane_row * width, (plane_row % height) * (width - 1)
        total = 0.0
        for x in range(width):
            total = get(planes, start + x) + (total * get(weights, edge + x - 1) if x > 0 else 0.0)
            put(sums, start + x, total)
        total = 0.0
        for x in range(width - 2, -1, -1):
            total = (total + get(planes, start + x + 1)) * get(weights, edge + x)
            put(sums, start + x, get(sums, start + x) + total)


@kernel()
def spread_down_columns(planes, weights, sums):
    """As `spread_along_rows`, along each column, with `weights` (H - 1, W)."""
    height, width = planes.shape[1], planes.shape[2]
    total = np.zeros(width)
    for plane in range(planes.shape[0]):
        start = plane * height * width
        for x in range(width):
            put(sums, start + x, get(planes, start + x))
            put(total, x, 0.0)
        for y in range(1, height):
            for x in range(width):
                at = start + y * width + x
                put(sums, at, get(planes, at) + get(sums, at - width) * get(weights, (y - 1) * width + x))
        for y in range(height - 2, -1, -1):
            for x in range(width):
                at = start + y * width + x
                put(total, x, (get(total, x) + get(planes, at + width)) * get(weights, y * width + x))
                put(sums, at, get(sums, at) + get(total, x))
