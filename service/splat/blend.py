"""Front-to-back blending (Eq. 19-20), tile by tile in float32, from float64 offsets per (tile, Gaussian).

Inside a tile the two normalised offsets u1, u2 change by constant steps; all are formed in float64 at the tile's centre
and only then rounded, so the error of an alpha does not grow with the footprint. A tile's list is taken in pieces that
fit the first-level cache. For each of its 16 blocks of 8 x 8 pixels an exact test leaves the Gaussians whose alpha
passes the cut somewhere in the block, and `vectors.py` blends those.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .binning import TILE, Grid, TileLists
from .definition import Definition
from .kernel_cache import kernel
from .parallel import run_ranges
from .vectors import (
    BLOCK_STATE,
    ENTRY,
    SIDE,
    blend_colour,
    blend_depth,
    blend_exclusive,
    prefetch,
)

F32 = NDArray[np.float32]

PIECE = 256  # entries taken at a time: 16 KiB, and 10 KiB more for the test against the blocks
ACROSS = TILE // SIDE  # blocks in a row of a tile
BLOCKS = ACROSS * ACROSS
TILE_STATE = BLOCKS * BLOCK_STATE  # floats
AHEAD = 16  # entries between asking for a record and reading it
CENTRE = np.float32(0.5 * (TILE - 1))
REACH_SLACK = np.float32(1e-3)  # on log2 alpha in the block test, whose float32 error is below 1e-4
COLOUR, DEPTH, EXCLUSIVE = 0, 1, 2  # which loop of `vectors.py`
ZERO, ONE = np.float32(0.0), np.float32(1.0)


@dataclass(frozen=True, eq=False)
class Canvas:
    """What is being drawn; `state` keeps unfinished tiles between batches and is empty when one batch is all."""

    rgb: F32  # (H, W, 3)
    alpha: F32  # (H, W), or (0, 0) where it is not asked for
    depth: F32  # the same
    state: F32  # (tiles, TILE_STATE) or (0, TILE_STATE)
    background: F32  # (3,)


def blend(
    lists: TileLists, records: NDArray[np.float64], canvas: Canvas, grid: Grid, definition: Definition, threads: int,
    *, first_batch: bool,
) -> None:  # fmt: skip
    """Blend the lists behind what the canvas holds already; the last batch composites the result into the pictures.

    records (N, 8): see `prepare.py`.
    """
    offsets = lists.offsets
    # Ranges of equal work: an entry costs about as much as a fiftieth of starting and storing a tile.
    work = offsets + 50 * np.arange(len(offsets))
    parts = 1 if threads == 1 else min(grid.tiles, 16 * threads)
    bounds = np.searchsorted(work, np.linspace(0, work[-1], parts + 1))
    bounds[0], bounds[-1] = 0, grid.tiles
    mode = EXCLUSIVE if not definition.inclusive_stop else DEPTH if canvas.depth.size else COLOUR
    cuts = np.array([definition.alpha_max, definition.stop], np.float32)
    narrow = records.view(np.float32)
    run_ranges(
        lambda first, last: blend_range(
            first, last, grid.width, grid.height, offsets, lists.members, records, narrow, canvas.state, canvas.rgb,
            canvas.alpha, canvas.depth, canvas.background, cuts, mode, first_batch, lists.last,
        ),
        bounds,
        threads,
    )  # fmt: skip


@kernel()
def blend_range(
    first, last, width, height, offsets, members, records, narrow, states, rgb, alpha, depth, background, cuts, mode,
    first_batch, last_batch,
):  # fmt: skip
    """Blend the lists of tiles first..last-1."""
    columns = (width + TILE - 1) // TILE
    own = np.empty(TILE_STATE, np.float32)
    entries = np.empty(PIECE * ENTRY, np.float32)
    fields = np.empty(10 * PIECE, np.float32)
    reach = np.empty(PIECE, np.float32)
    chosen = np.empty(PIECE + 1, np.int32)
    for tile in range(first, last):
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        state = states[tile] if states.shape[0] else own
        if first_batch:
            start_tile(state, left, top, width, height)
        live = live_blocks(state, cuts[1], mode)
        begin, end = offsets[tile], offsets[tile + 1]
        for piece in range(begin, end, PIECE):
            if live == 0:
                break
            count = min(PIECE, end - piece)
            gather(members, records, narrow, piece, count, end, left, top, entries, fields)
            for block in range(BLOCKS):
                if (live >> block) & 1 == 0:
                    continue
                x0 = np.float32((block % ACROSS) * SIDE) - CENTRE
                y0 = np.float32((block // ACROSS) * SIDE) - CENTRE
                measure_reach(fields, count, x0, y0, reach)
                kept = choose(reach, count, chosen)
                if kept == 0:
                    continue
                at = block * BLOCK_STATE
                if mode == COLOUR:
                    goes_on = blend_colour(entries, chosen, 0, kept, x0, y0, state, at, cuts[0], cuts[1])
                elif mode == DEPTH:
                    goes_on = blend_depth(entries, chosen, 0, kept, x0, y0, state, at, cuts[0], cuts[1])
                else:
                    goes_on = blend_exclusive(entries, chosen, 0, kept, x0, y0, state, at, cuts[0], cuts[1])
                if goes_on == 0:
                    live &= ~(1 << block)
        if last_batch:
            store_tile(state, left, top, width, height, rgb, alpha, depth, background)


@kernel()
def start_tile(state, left, top, width, height):
    """Full light and no colour; positions outside the image count as finished."""
    state[:] = ZERO
    for row in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            state[place(row, column)] = ONE


@kernel()
def place(row, column):
    """Where a tile's pixel has its transmittance; the other channels follow at distances of one block."""
    block = np.uint64((row // SIDE) * ACROSS + column // SIDE)
    return block * np.uint64(BLOCK_STATE) + np.uint64((row % SIDE) * SIDE + column % SIDE)


@kernel()
def live_blocks(state, stop, mode):
    """A bit per block that a further Gaussian can change."""
    live = 0
    for block in range(BLOCKS):
        most = ZERO
        for pixel in range(SIDE * SIDE):
            most = max(most, state[np.uint64(block * BLOCK_STATE + pixel)])
        if most > (ZERO if mode == EXCLUSIVE else stop):
            live |= 1 << block
    return live


@kernel()
def gather(members, records, narrow, piece, count, end, left, top, entries, fields):
    """Copy the records of members[piece:piece+count], relative to the tile's centre: rows of `entries` for blending,
    columns of `fields` for the test against the blocks."""
    centre_x, centre_y = left + 0.5 * TILE, top + 0.5 * TILE
    for j in range(count):
        prefetch(records, np.int64(members[np.uint64(min(piece + j + AHEAD, end - 1))]) * 8)
        i = np.uint64(members[np.uint64(piece + j)])
        inverse1, k, inverse2 = records[i, 2], records[i, 3], records[i, 4]
        x, y = centre_x - records[i, 0], centre_y - records[i, 1]
        u1, u2 = np.float32(x * inverse1), np.float32((y - k * x) * inverse2)
        step1, step2, shear2 = np.float32(inverse1), np.float32(inverse2), np.float32(k * inverse2)
        to, at = np.uint64(j * ENTRY), np.uint64(j)
        entries[to], entries[to + np.uint64(1)], entries[to + np.uint64(2)] = u1, step1, u2
        entries[to + np.uint64(3)], entries[to + np.uint64(4)] = shear2, step2
        for field in range(6):  # log2 opacity, red, green, blue, depth, cut
            entries[to + np.uint64(5 + field)] = narrow[i, np.uint64(10 + field)]
        fields[at], fields[at + np.uint64(PIECE)], fields[at + np.uint64(2 * PIECE)] = u1, step1, u2
        fields[at + np.uint64(3 * PIECE)], fields[at + np.uint64(4 * PIECE)] = shear2, step2
        fields[at + np.uint64(5 * PIECE)] = narrow[i, np.uint64(10)] - narrow[i, np.uint64(15)]
        fields[at + np.uint64(9 * PIECE)] = np.float32(-y)
    for j in range(count):
        at = np.uint64(j)
        step1, shear2 = fields[at + np.uint64(PIECE)], fields[at + np.uint64(3 * PIECE)]
        fields[at + np.uint64(6 * PIECE)] = ONE / step1
        fields[at + np.uint64(7 * PIECE)] = ONE / fields[at + np.uint64(4 * PIECE)]
        fields[at + np.uint64(8 * PIECE)] = ONE / (step1 * step1 + shear2 * shear2)


@kernel(fastmath=frozenset({"contract"}))
def measure_reach(fields, count, x0, y0, reach):
    """How far the largest log2 alpha that each Gaussian has within the block at (x0, y0) lies above its cut.

    The squared distance is convex, so its least value over a box lies at the centre or on an edge that faces it: the
    vertical edge (or column) nearest to the centre with the best row, or the horizontal one with the best column.
    """
    x1, y1 = x0 + np.float32(SIDE - 1), y0 + np.float32(SIDE - 1)
    for j in range(count):
        at = np.uint64(j)
        u1, step1, u2 = fields[at], fields[at + np.uint64(PIECE)], fields[at + np.uint64(2 * PIECE)]
        shear2, step2 = fields[at + np.uint64(3 * PIECE)], fields[at + np.uint64(4 * PIECE)]
        x = min(max(-u1 * fields[at + np.uint64(6 * PIECE)], x0), x1)
        across, start = u1 + x * step1, u2 - x * shear2
        y = min(max(-start * fields[at + np.uint64(7 * PIECE)], y0), y1)
        down = start + y * step2
        nearest = across * across + down * down
        y = min(max(fields[at + np.uint64(9 * PIECE)], y0), y1)
        start = u2 + y * step2
        x = min(max((start * shear2 - u1 * step1) * fields[at + np.uint64(8 * PIECE)], x0), x1)
        across, down = u1 + x * step1, start - x * shear2
        reach[at] = fields[at + np.uint64(5 * PIECE)] - min(nearest, across * across + down * down)


@kernel()
def choose(reach, count, chosen):
    """Positions at which `reach` is not below zero, but for rounding, in order; returns how many."""
    kept = np.uint64(0)
    for j in range(count):
        chosen[kept] = np.int32(j)
        kept += np.uint64(reach[np.uint64(j)] >= -REACH_SLACK)
    return np.int64(kept)


@kernel(fastmath=frozenset({"contract"}))
def store_tile(state, left, top, width, height, rgb, alpha, depth, background):
    """Colour over the background, opacity and expected depth of the tile's pixels."""
    red, green, blue = background[0], background[1], background[2]
    distance = np.uint64(SIDE * SIDE)
    with_alpha, with_depth = alpha.size > 0, depth.size > 0
    for row in range(min(TILE, height - top)):
        for column in range(min(TILE, width - left)):
            at = place(row, column)
            y, x = np.uint64(top + row), np.uint64(left + column)
            light = abs(state[at])
            rgb[y, x, 0] = state[at + distance] + light * red
            rgb[y, x, 1] = state[at + np.uint64(2) * distance] + light * green
            rgb[y, x, 2] = state[at + np.uint64(3) * distance] + light * blue
            if with_alpha:
                alpha[y, x] = ONE - light
            if with_depth:
                covered = ONE - light
                depth[y, x] = state[at + np.uint64(4) * distance] / covered if covered > ZERO else ZERO


@kernel()
def bytes_of(values, out):
    """values in [0, 1], clipped, times 255 and rounded."""
    for i in range(values.shape[0]):
        value = min(max(values[i], ZERO), ONE) * np.float32(255.0) + np.float32(0.5)
        out[i] = np.uint8(np.int32(value))
