"""Binning into tile lists: for each tile of 32 x 32 px the Gaussians that touch it, nearest first, in batches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .access import get, larger, put, smaller
from .kernel_cache import kernel
from .parallel import run_ranges
from .project import Projection
from .spans import TILE, add_to_counts, small_box, tile_span, unpacked_box


@dataclass(frozen=True)
class Grid:
    """An image of width x height px cut into tiles, row-major."""

    width: int
    height: int

    @property
    def columns(self) -> int:
        return -(-self.width // TILE)

    @property
    def rows(self) -> int:
        return -(-self.height // TILE)

    @property
    def tiles(self) -> int:
        return self.columns * self.rows


@dataclass(frozen=True, eq=False)
class TileLists:
    """Tile t holds `members[offsets[t]:offsets[t + 1]]`, indices into the projection, nearest first."""

    offsets: NDArray[np.int64]  # (tiles + 1,)
    members: NDArray[np.int32]  # (entries,)
    last: bool  # no further batch follows


def tile_lists(
    projection: Projection, order: NDArray[np.int32], grid: Grid, max_entries: int, threads: int
) -> Iterator[TileLists]:
    """Tile lists in batches: each covers a consecutive range of `order` with at most `max_entries` entries in all.

    One batch is nearly always enough. A single Gaussian has at most one entry per tile and may exceed the limit by
    itself, so the lists take at most 4 bytes x max(max_entries, tiles), plus 24 bytes per tile and, with several
    batches, 16 per Gaussian.
    """
    if int(projection.counts.sum()) <= max_entries:
        yield _fill(projection, order, projection.counts, grid, threads, last=True)
        return
    touched = np.empty(len(order), np.int64)
    space = projection.space
    ellipses = (space.boxes, space.records, space.extents)
    count_range(0, len(order), *ellipses, order, grid.columns, np.zeros(grid.tiles, np.int64), touched)
    ends = np.cumsum(touched)
    start = 0
    while start < len(order):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + max_entries, side="right")))
        counts = np.zeros(grid.tiles, np.int64)
        count_range(start, stop, *ellipses, order, grid.columns, counts, touched)
        yield _fill(projection, order[start:stop], counts, grid, threads, last=stop == len(order))
        start = stop


def _fill(
    projection: Projection, order: NDArray[np.int32], counts: NDArray[np.int64], grid: Grid, threads: int, *, last: bool
) -> TileLists:
    offsets = np.zeros(grid.tiles + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    members = np.empty(offsets[-1], np.int32)
    cursors, space = offsets[:-1].copy(), projection.space
    boxes = space.boxes[order]  # gathered once: every thread reads all of them
    # Each thread visits all Gaussians and fills a range of tile rows, chosen so that all have equally many entries.
    shares = np.linspace(0, offsets[-1], threads + 1)
    bounds = np.searchsorted(offsets[:: grid.columns], shares)
    bounds[0], bounds[-1] = 0, grid.rows
    run_ranges(
        lambda top, bottom: fill_rows(
            top, bottom, boxes, space.records, space.extents, order, grid.columns, cursors, members
        ),
        np.unique(bounds),
        threads,
    )
    return TileLists(offsets, members, last)


@kernel()
def count_range(start, stop, boxes, records, extents, order, columns, counts, touched):
    """Add the entries of order[start:stop] to `counts` (tiles,), and set `touched` (M,) to the tiles of each one."""
    for rank in range(start, stop):
        put(touched, rank, add_to_counts(boxes, records, extents, np.int64(get(order, rank)), columns, counts))


@kernel()
def fill_rows(first_row, end_row, boxes, records, extents, order, columns, cursors, members):
    """Append `order` to the lists `members` of the tiles in rows first_row..end_row-1, advancing their `cursors`.

    boxes (M,) are sorted in the same order.
    """
    for rank in range(order.size):
        i = np.int64(get(order, rank))
        left, right, top, bottom = unpacked_box(get(boxes, rank))
        narrow = small_box(left, right, top, bottom)
        for tile_row in range(larger(top, first_row), smaller(bottom, end_row - 1) + 1):
            first, last = (left, right) if narrow else tile_span(records, extents, i, tile_row, left, right)
            for column in range(first, last + 1):
                tile = tile_row * columns + column
                cursor = get(cursors, tile)
                put(members, cursor, i)
                put(cursors, tile, cursor + 1)
