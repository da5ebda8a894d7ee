"""The tiles of an ellipse: those of its bounding box or, where that is large, the exact span of each tile row."""

from __future__ import annotations

import math

import numpy as np

from .access import get, larger, put, round_down, round_up, smaller
from .kernel_cache import kernel
from .prepare import EXTENT, RECORD

TILE = 32  # px: 16 blocks of 8 x 8, whose state (20 KiB) and one piece of the list stay in the L1 cache
BITS = 16  # of a box's four tile numbers
MAX_SIDE = TILE << BITS  # px


@kernel()
def packed_box(first_x, last_x, first_y, last_y):
    """The first and last tile column and row of a pixel box, packed into a uint64."""
    return (
        np.uint64(first_x) // np.uint64(TILE)
        | (np.uint64(last_x) // np.uint64(TILE)) << np.uint64(BITS)
        | (np.uint64(first_y) // np.uint64(TILE)) << np.uint64(2 * BITS)
        | (np.uint64(last_y) // np.uint64(TILE)) << np.uint64(3 * BITS)
    )


@kernel()
def unpacked_box(box):
    """First and last tile column, first and last tile row."""
    mask = np.uint64((1 << BITS) - 1)
    left, right = np.int64(box & mask), np.int64((box >> np.uint64(BITS)) & mask)
    return left, right, np.int64((box >> np.uint64(2 * BITS)) & mask), np.int64(box >> np.uint64(3 * BITS))


@kernel()
def small_box(left, right, top, bottom):
    """Whether all tiles of the box are listed: at most 2 x 2, or one row or column; exact spans would cost more."""
    return (right - left <= 1 and bottom - top <= 1) or left == right or top == bottom


@kernel()
def tile_span(records, extents, i, tile_row, left, right):
    """First and last tile column, within left..right, that the ellipse of Gaussian i touches in a tile row; (0, -1) if
    none.

    Within a strip the ellipse extends farthest right at its rightmost point if that lies inside, else on the edge
    nearest to it; at height d its chord is k' d +- h sqrt(half_height^2 - d^2), with k' and h of the transposed factor.
    """
    record, extent = i * RECORD, i * EXTENT
    x, y, k = get(records, record), get(records, record + 1), get(records, record + 3)
    half_width, half_height, shear = get(extents, extent), get(extents, extent + 1), get(extents, extent + 2)
    top = larger(tile_row * TILE + 0.5 - y, -half_height)
    bottom = smaller((tile_row + 1) * TILE - 0.5 - y, half_height)
    aspect = half_width / half_height
    slope = k * aspect * aspect
    d = smaller(larger(k * half_width, top), bottom)
    end = x + slope * d + shear * math.sqrt(larger((half_height - d) * (half_height + d), 0.0))
    d = smaller(larger(-k * half_width, top), bottom)
    start = x + slope * d - shear * math.sqrt(larger((half_height - d) * (half_height + d), 0.0))
    slack = 0.5 + 1e-14 * (half_width + abs(x))  # half a pixel, and the rounding of the two chord ends
    # Pixel centres within start..end; clamped before they become integers.
    low, high = left * TILE - 1.0, right * TILE + TILE + 0.0
    first = round_up(smaller(larger(start - slack, low), high))
    last = round_down(smaller(larger(end - 1.0 + slack, low), high))
    if first > last:
        return 0, -1
    return larger(np.int64(first) // TILE, left), smaller(np.int64(last) // TILE, right)


@kernel()
def add_to_counts(boxes, records, extents, i, columns, counts):
    """Increment the count of every tile that Gaussian i touches; returns the number of these tiles."""
    left, right, top, bottom = unpacked_box(get(boxes, i))
    narrow = small_box(left, right, top, bottom)
    total = 0
    for tile_row in range(top, bottom + 1):
        first, last = (left, right) if narrow else tile_span(records, extents, i, tile_row, left, right)
        for column in range(first, last + 1):
            tile = tile_row * columns + column
            put(counts, tile, get(counts, tile) + 1)
        total += larger(last - first + 1, 0)
    return total
