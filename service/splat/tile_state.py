"""The pixels of one tile while they are blended: 16 blocks of 8 x 8, channel by channel, made into pictures."""

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
    """How many floats a tile's state has."""
    return BLOCKS * channels * PIXELS


@kernel()
def corner(block):
    """The centre of a block's first pixel, px from the tile's centre."""
    return np.float32((block % ACROSS) * SIDE) - CENTRE, np.float32((block // ACROSS) * SIDE) - CENTRE


@kernel()
def place(row, column, size):
    """Where a tile's pixel has its transmittance, in a state of `size` floats; other channels follow PIXELS apart."""
    block = (row // SIDE) * ACROSS + column // SIDE
    return block * (size // BLOCKS) + (row % SIDE) * SIDE + column % SIDE


@kernel()
def start_tile(state, left, top, width, height):
    """Full light and no colour; positions outside the image count as finished."""
    for at in range(state.size):
        put(state, at, ZERO)
    for row in range(smaller(TILE, height - top)):
        for column in range(smaller(TILE, width - left)):
            put(state, place(row, column, state.size), ONE)


@kernel()
def live_blocks(state, finished):
    """A bit per block that a further Gaussian can change: some light above `finished`."""
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
    """Colour over the background, opacity and depths of the tile's pixels."""
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
    """values in [0, 1], clipped, times 255 and rounded."""
    for i in range(values.size):
        value = smaller(larger(get(values, i), ZERO), ONE) * np.float32(255.0) + np.float32(0.5)
        put(out, i, np.uint8(np.int32(value)))
