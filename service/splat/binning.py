"""Tile lists: for every 16 x 16 px tile the Gaussians whose ellipse touches it, nearest first, in bounded batches."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kernel_cache import kernel
from .parallel import run_ranges

TILE = 16  # px: a row is one AVX-512 vector, and the colour state of a tile (5 KiB) stays in the first-level cache


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


def tile_lists(
    footprints: NDArray[np.float64], order: NDArray[np.int64], grid: Grid, max_entries: int, threads: int
) -> Iterator[TileLists]:
    """Lists of consecutive stretches of `order`, at most `max_entries` long each; one is nearly always enough.

    A single Gaussian may exceed the limit by itself (it has at most one entry per tile), so memory is bounded by
    4 bytes x max(max_entries, tiles) plus 4 bytes per tile and thread.
    """
    touched = np.zeros(len(order), np.int64)
    bounds, counts = _count(footprints, order, 0, len(order), grid, touched, threads)
    ends = np.cumsum(touched)
    start = 0
    while start < len(order):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + max_entries, side="right")))
        if stop - start < len(order):
            bounds, counts = _count(footprints, order, start, stop, grid, touched, threads)
        yield _fill(footprints, order, bounds, counts, grid, threads)
        start = stop


def _count(
    footprints: NDArray, order: NDArray, start: int, stop: int, grid: Grid, touched: NDArray, threads: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    bounds = np.linspace(start, stop, threads + 1).astype(np.int64)
    counts = np.zeros((threads, grid.tiles), np.int64)
    work = {int(a): row for row, a in zip(counts, bounds[:-1], strict=True)}
    run_ranges(
        lambda a, b: count_range(a, b, footprints, order, grid.width, grid.height, work[a], touched), bounds, threads
    )
    return bounds, counts


def _fill(footprints: NDArray, order: NDArray, bounds: NDArray, counts: NDArray, grid: Grid, threads: int) -> TileLists:
    # Where each thread's share of each tile starts: earlier threads hold nearer Gaussians.
    within = np.cumsum(counts, axis=0)
    offsets = np.zeros(grid.tiles + 1, np.int64)
    np.cumsum(within[-1], out=offsets[1:])
    cursors = offsets[:-1] + within - counts
    members = np.empty(offsets[-1], np.int32)
    work = {int(a): row for row, a in zip(cursors, bounds[:-1], strict=True)}
    run_ranges(
        lambda a, b: fill_range(a, b, footprints, order, grid.width, grid.height, work[a], members), bounds, threads
    )
    return TileLists(offsets, members)


@kernel()
def pixel_span(center, half, size):
    """First and last pixel whose centre lies within center +- half, inside 0..size-1; empty if first > last."""
    first = max(math.ceil(center - half - 0.5), 0.0)
    last = min(math.floor(center + half - 0.5), size - 1.0)
    if not first <= last:
        return 0, -1
    return int(first), int(last)


@kernel()
def tile_span(footprints, i, tile_row, first, last, width):
    """First and last tile column that the ellipse touches with the pixel rows first..last of one tile row.

    Over a strip the ellipse reaches furthest right at its rightmost point if that lies inside, else at the edge nearest
    to it; at height d its chord is k' d +- h sqrt(half_height^2 - d^2), with k' and h of the transposed factor.
    """
    x, y, k = footprints[i, 0], footprints[i, 1], footprints[i, 3]
    half_width, half_height, shear = footprints[i, 5], footprints[i, 6], footprints[i, 7]
    if first // TILE == last // TILE:  # the strip holds the whole ellipse
        first_x, last_x = pixel_span(x, half_width, width)
        return first_x // TILE, last_x // TILE
    top = max(max(first, tile_row * TILE) + 0.5 - y, -half_height)
    bottom = min(min(last, tile_row * TILE + TILE - 1) + 0.5 - y, half_height)
    aspect = half_width / half_height
    slope = k * aspect * aspect
    d = min(max(k * half_width, top), bottom)
    right = slope * d + shear * math.sqrt(max((half_height - d) * (half_height + d), 0.0))
    d = min(max(-k * half_width, top), bottom)
    left = slope * d - shear * math.sqrt(max((half_height - d) * (half_height + d), 0.0))
    slack = 1e-14 * half_width  # rounding of the two chord ends
    first_x, last_x = pixel_span(x + 0.5 * (left + right), 0.5 * (right - left) + slack, width)
    return first_x // TILE, last_x // TILE


@kernel()
def count_range(start, stop, footprints, order, width, height, counts, touched):
    """Add the entries of order[start:stop] to `counts` (tiles,) and set `touched` (M,), how many each one has."""
    columns = (width + TILE - 1) // TILE
    for rank in range(start, stop):
        i = order[rank]
        first, last = pixel_span(footprints[i, 1], footprints[i, 6], height)
        total = 0
        for tile_row in range(first // TILE, last // TILE + 1):
            left, right = tile_span(footprints, i, tile_row, first, last, width)
            for column in range(left, right + 1):
                counts[tile_row * columns + column] += 1
            total += max(right - left + 1, 0)
        touched[rank] = total


@kernel()
def fill_range(start, stop, footprints, order, width, height, cursors, members):
    """Write order[start:stop] into `members` at each tile's cursor, which moves on."""
    columns = (width + TILE - 1) // TILE
    for rank in range(start, stop):
        i = order[rank]
        first, last = pixel_span(footprints[i, 1], footprints[i, 6], height)
        for tile_row in range(first // TILE, last // TILE + 1):
            left, right = tile_span(footprints, i, tile_row, first, last, width)
            for column in range(left, right + 1):
                tile = tile_row * columns + column
                members[cursors[tile]] = i
                cursors[tile] += 1
