"""Front-to-back alpha blending (Eq. 19-20), tile by tile in float32, from float64 offsets per (tile, Gaussian).

Within a tile the normalised offsets u1, u2 are linear in the pixel position. They and their steps are computed in
float64 at the tile's centre and rounded once, so the error of an alpha does not grow with the footprint. A tile's list
is processed in pieces that fit the L1 cache. For each of the 16 blocks of 8 x 8 pixels an exact test selects the
Gaussians whose alpha passes the cut somewhere in the block, and `vectors.py` blends those.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .access import get, larger, prefetch, put, smaller, take
from .binning import TILE, Grid, TileLists
from .definition import Definition
from .kernel_cache import kernel
from .parallel import run_ranges
from .prepare import LOG2_CUT, LOG2_OPACITY, RECORD
from .tile_state import BLOCKS, corner, live_blocks, start_tile, store_tile
from .vectors import ENTRY, SHEAR2, SIDE, STEP1, STEP2, U1, U2, blend_block
from .vectors import LOG2_OPACITY as ENTRY_LOG2_OPACITY

F32 = NDArray[np.float32]

PIECE = 256  # entries processed at a time: 16 KiB, and 10 KiB more for the block test
TOGETHER = 4  # most tiles that a thread claims at a time: neighbouring tiles share Gaussians
AHEAD = 16  # prefetch distance, entries
REACH_SLACK = np.float32(1e-3)  # on log2 alpha in the block test, whose float32 error is below 1e-4 at dilation 0.3
ZERO, ONE = np.float32(0.0), np.float32(1.0)


@dataclass(frozen=True, eq=False)
class Canvas:
    """The planes of a render; `state` keeps unfinished tiles between batches and is empty for a single batch."""

    rgb: F32  # (H, W, 3)
    alpha: F32  # (H, W), or (0, 0) where it is not asked for
    depth: F32 | None  # (H, W)
    median: F32 | None  # (H, W); with it `removed` and `peaks` are there too, and `depth`
    removed: F32 | None  # (H, W)
    peaks: F32 | None  # (N,) at first 0
    state: F32  # (tiles, floats of a tile) or (0, floats of a tile)
    background: F32  # (3,)


class Blended(NamedTuple):
    """Counts of one call of `blend`."""

    blocks: int  # blended pairs of a Gaussian and a block of 8 x 8 pixels
    pairs: int  # blended pairs of a Gaussian and a pixel, counted only where `peaks` are asked for
    unfinished: int  # tiles that a further Gaussian could change


def blend(
    lists: TileLists, records: NDArray[np.float64], canvas: Canvas, grid: Grid, definition: Definition, threads: int,
    *, first_batch: bool,
) -> Blended:  # fmt: skip
    """Blend a batch of lists behind what the canvas holds; the last batch composites the result over the background.

    records (N, 8): see `prepare.py`.
    """
    cuts = np.array([definition.alpha_max, definition.stop], np.float32)
    narrow = records.view(np.float32)
    exclusive = None if definition.inclusive_stop else True
    counter = np.zeros(1, np.int64)  # of the tiles that have been claimed
    workers = min(threads, grid.tiles)
    together = max(1, min(TOGETHER, grid.tiles // (4 * workers)))
    own = None if canvas.peaks is None else np.zeros((workers, len(canvas.peaks)), np.float32)
    counts = run_ranges(
        lambda worker, _: blend_tiles(
            counter, together, grid.width, grid.height, lists.offsets, lists.members, records, narrow, canvas.state,
            canvas.rgb, canvas.alpha, canvas.depth, canvas.median, canvas.removed,
            None if own is None else own[worker], canvas.background, cuts, exclusive, first_batch, lists.last,
        ),
        range(workers + 1),
        threads,
    )  # fmt: skip
    if own is not None and canvas.peaks is not None:
        np.maximum(canvas.peaks, own.max(axis=0), out=canvas.peaks)
    return Blended(*(sum(column) for column in zip(*counts, strict=True)))


@kernel()
def blend_tiles(
    counter, together, width, height, offsets, members, records, narrow, states, rgb, alpha, depth, median, removed,
    peaks, background, cuts, exclusive, first_batch, last_batch,
):  # fmt: skip
    """Blend the lists of tiles as long as `counter` has any; returns pairs with blocks, pairs with pixels, and how many
    of these tiles a further Gaussian could change."""
    columns = (width + TILE - 1) // TILE
    tiles = columns * ((height + TILE - 1) // TILE)
    size = states.shape[1]
    own = np.empty(size, np.float32)
    entries = np.empty(PIECE * ENTRY, np.float32)
    fields = np.empty(10 * PIECE, np.float32)
    reach, tops = np.empty(PIECE, np.float32), np.zeros(PIECE, np.float32)
    chosen = np.empty(PIECE + 1, np.int32)
    alpha_max, stop = get(cuts, 0), get(cuts, 1)
    # A pixel is finished when its transmittance is at most this; an exclusive stop marks it by a negative one.
    finished = stop if exclusive is None else ZERO
    blocks = pairs = unfinished = 0
    start = take(counter, together)
    while start < tiles:
        for tile in range(start, smaller(start + together, tiles)):
            left, top = (tile % columns) * TILE, (tile // columns) * TILE
            state = states[tile] if states.shape[0] else own
            if first_batch:
                start_tile(state, left, top, width, height)
            live = live_blocks(state, finished)
            begin, end = get(offsets, tile), get(offsets, tile + 1)
            for piece in range(begin, end, PIECE):
                if live == 0:
                    break
                count = smaller(PIECE, end - piece)
                gather(members, records, narrow, piece, count, end, left, top, entries, fields)
                for block in range(BLOCKS):
                    if (live >> block) & 1 == 0:
                        continue
                    x0, y0 = corner(block)
                    measure_reach(fields, count, x0, y0, reach)
                    kept = choose(reach, count, chosen)
                    if kept == 0:
                        continue
                    at = block * (size // BLOCKS)
                    found = blend_block(
                        entries, chosen, kept, x0, y0, state, at, alpha_max, stop, tops, depth, median, exclusive
                    )
                    if found & 1 == 0:
                        live &= ~(1 << block)
                    blocks += kept
                    pairs += found >> 1
                if peaks is not None:
                    for j in range(count):
                        member = np.int64(get(members, piece + j))
                        put(peaks, member, larger(get(peaks, member), get(tops, j)))
                        put(tops, j, ZERO)
            unfinished += 1 if live != 0 else 0
            if last_batch:
                store_tile(state, left, top, width, height, rgb, alpha, depth, median, removed, background)
        start = take(counter, together)
    return blocks, pairs, unfinished


@kernel()
def gather(members, records, narrow, piece, count, end, left, top, entries, fields):
    """Copy the records of members[piece:piece+count], relative to the tile's centre: as rows of `entries` for blending
    and as columns of `fields` for the block test."""
    centre_x, centre_y = left + 0.5 * TILE, top + 0.5 * TILE
    for j in range(count):
        prefetch(records, np.int64(get(members, smaller(piece + j + AHEAD, end - 1))) * RECORD)
        record = np.int64(get(members, piece + j)) * RECORD
        inverse1, k = get(records, record + 2), get(records, record + 3)
        inverse2 = get(records, record + 4)
        x, y = centre_x - get(records, record), centre_y - get(records, record + 1)
        u1, u2 = np.float32(x * inverse1), np.float32((y - k * x) * inverse2)
        step1, step2, shear2 = np.float32(inverse1), np.float32(inverse2), np.float32(k * inverse2)
        to = j * ENTRY
        put(entries, to + U1, u1)
        put(entries, to + STEP1, step1)
        put(entries, to + U2, u2)
        put(entries, to + SHEAR2, shear2)
        put(entries, to + STEP2, step2)
        for field in range(6):  # log2 opacity, red, green, blue, depth, cut: in the same order in both
            put(entries, to + ENTRY_LOG2_OPACITY + field, get(narrow, 2 * record + LOG2_OPACITY + field))
        put(fields, j, u1)
        put(fields, j + PIECE, step1)
        put(fields, j + 2 * PIECE, u2)
        put(fields, j + 3 * PIECE, shear2)
        put(fields, j + 4 * PIECE, step2)
        put(fields, j + 5 * PIECE, get(narrow, 2 * record + LOG2_OPACITY) - get(narrow, 2 * record + LOG2_CUT))
        put(fields, j + 6 * PIECE, np.float32(-x))  # not of u1 and step1, which a needle of 1e38 px makes denormal
        put(fields, j + 9 * PIECE, np.float32(-y))
    for j in range(count):
        step1, shear2 = get(fields, j + PIECE), get(fields, j + 3 * PIECE)
        put(fields, j + 7 * PIECE, ONE / get(fields, j + 4 * PIECE))
        put(fields, j + 8 * PIECE, ONE / (step1 * step1 + shear2 * shear2))


@kernel(fastmath=frozenset({"contract"}))
def measure_reach(fields, count, x0, y0, reach):
    """Set `reach` (count,) to the largest log2 alpha of each Gaussian in the block at (x0, y0), less that of its cut.

    The squared distance is convex, so its minimum over a box lies at the centre or on an edge that faces it: on the
    vertical line nearest to the centre at the best row, or on the horizontal one at the best column.
    """
    x1, y1 = x0 + np.float32(SIDE - 1), y0 + np.float32(SIDE - 1)
    for j in range(count):
        u1, step1, u2 = get(fields, j), get(fields, j + PIECE), get(fields, j + 2 * PIECE)
        shear2, step2 = get(fields, j + 3 * PIECE), get(fields, j + 4 * PIECE)
        x = smaller(larger(get(fields, j + 6 * PIECE), x0), x1)
        across, start = u1 + x * step1, u2 - x * shear2
        y = smaller(larger(-start * get(fields, j + 7 * PIECE), y0), y1)
        down = start + y * step2
        nearest = across * across + down * down
        y = smaller(larger(get(fields, j + 9 * PIECE), y0), y1)
        start = u2 + y * step2
        x = smaller(larger((start * shear2 - u1 * step1) * get(fields, j + 8 * PIECE), x0), x1)
        across, down = u1 + x * step1, start - x * shear2
        put(reach, j, get(fields, j + 5 * PIECE) - smaller(nearest, across * across + down * down))


@kernel()
def choose(reach, count, chosen):
    """Write to `chosen` the positions, ascending, where `reach` >= 0 within rounding; returns their number."""
    kept = 0
    for j in range(count):
        put(chosen, kept, j)
        kept += 1 if get(reach, j) >= -REACH_SLACK else 0
    return kept
