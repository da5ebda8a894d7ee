"""The state of one tile while it is blended, 16 blocks of 8 x 8 pixels by channel, and its output to the planes."""

from __future__ import annotations

import numpy as np

from .access import get, larger, put, smaller
from .kernel_cache import kernel
from .spans import TILE
from .vectors import COLOUR, DEPTH_SUM, LIGHT, MEDIAN, PIXELS, REMOVED, SIDE

ACROSS = TILE // SIDE  # blocks in a row of a tile
BLOCKS = ACROSS * ACROSS
CENTRE = np.float32(0.5 * (TILE - 1))
ZERO, ONE = np.float32(0.0), np.float32(1.0)


def tile_floats(channels: int) -> int:
    """Number of floats in the state of a tile."""
    return BLOCKS * channels * PIXELS


@kernel()
def corner(block):
    """(x, y) of the centre of a block's first pixel, px from the tile's centre."""
    return np.float32((block % ACROSS) * SIDE) - CENTRE, np.float32((block // ACROSS) * SIDE) - CENTRE


@kernel()
def place(row, column, size):
    """Index of a pixel's transmittance in a tile state of `size` floats; its other channels follow PIXELS apart."""
    block = (row // SIDE) * ACROSS + column // SIDE
    return block * (size // BLOCKS) + (row % SIDE) * SIDE + column % SIDE


@kernel()
def start_tile(state, left, top, width, height):
    """Initialise to transmittance 1 and colour 0; pixels outside the image get 0, and so are finished."""
    for at in range(state.size):
        put(state, at, ZERO)
    for row in range(smaller(TILE, height - top)):
        for column in range(smaller(TILE, width - left)):
            put(state, place(row, column, state.size), ONE)


@kernel()
def live_blocks(state, finished):
    """Bit mask of unfinished blocks, those with a transmittance above `finished`."""
    live = 0
    for block in range(BLOCKS):
        most, start = ZERO, block * (state.size // BLOCKS)
        for pixel in range(PIXELS):
            most = larger(most, get(state, start + pixel))
        if most > finished:
            live |= 1 << block
    return live


@kernel(fastmath=frozenset({"contract"}))
def store_tile(state, left, top, width, height, rgb, alpha, depth, median, removed, background):
    """Write the tile's pixels to the planes: colour over the background, opacity, depths, removed mass."""
    red, green, blue = get(background, 0), get(background, 1), get(background, 2)
    with_alpha = alpha.size > 0
    for row in range(smaller(TILE, height - top)):
        for column in range(smaller(TILE, width - left)):
            at, to = place(row, column, state.size), (top + row) * width + left + column
            light = abs(get(state, at + LIGHT * PIXELS))
            put(rgb, 3 * to, get(state, at + COLOUR * PIXELS) + light * red)
            put(rgb, 3 * to + 1, get(state, at + (COLOUR + 1) * PIXELS) + light * green)
            put(rgb, 3 * to + 2, get(state, at + (COLOUR + 2) * PIXELS) + light * blue)
            covered = ONE - light
            if with_alpha:
                put(alpha, to, covered)
            if depth is not None:
                put(depth, to, get(state, at + DEPTH_SUM * PIXELS) / covered if covered > ZERO else ZERO)
            if median is not None:
                put(median, to, get(state, at + MEDIAN * PIXELS))
                put(removed, to, get(state, at + REMOVED * PIXELS))


@kernel()
def bytes_of(values, out):
    """Set `out` to values (flat float32) clipped to [0, 1], times 255, rounded; NaN becomes 0."""
    for i in range(values.size):
        value = smaller(larger(get(values, i), ZERO), ONE) * np.float32(255.0) + np.float32(0.5)
        put(out, i, np.uint8(np.int32(value)))
