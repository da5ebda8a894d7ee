"""Front-to-back blending (Eq. 19-20), tile by tile in float32, from float64 offsets per (tile, Gaussian).

Inside a tile the two normalised offsets u1, u2 change by constant steps; all three are formed in float64 at the tile's
centre and only then rounded. So the error of an alpha does not grow with the footprint: at most 1.2e-6 was measured for
needles of 1 to 1e8 px.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .binning import TILE, Grid, TileLists
from .definition import Definition
from .kernel_cache import kernel
from .parallel import run_ranges

F32 = NDArray[np.float32]

CHANNELS = 5  # transmittance, red, green, blue, depth
ROW = CHANNELS * TILE  # floats per tile row, one vector per channel
CENTRE = np.float32(0.5 * (TILE - 1))
CHECK = 16  # Gaussians between two looks whether the whole tile is finished

# 2^f on [-1, 0]: the polynomial of degree 5 of least relative error, 7.5e-8 in exact arithmetic (float32: 3e-7).
P0, P1, P2 = np.float32(0.999999925063486), np.float32(0.6931422525915897), np.float32(0.24017218923637174)
P3, P4, P5 = np.float32(0.05527972254858138), np.float32(0.009188611694800758), np.float32(0.0009387883227027494)
EXPONENT_MIN = np.float32(-125.0)  # the power stays a normal number; anything this faint is cut anyway

ZERO, ONE = np.float32(0.0), np.float32(1.0)


def start_planes(grid: Grid) -> tuple[F32, F32, F32]:
    """Colour (H, W, 3), transmittance (H, W) and depth sum (H, W) before the first Gaussian."""
    shape = (grid.height, grid.width)
    return np.zeros((*shape, 3), np.float32), np.ones(shape, np.float32), np.zeros(shape, np.float32)


def blend(
    lists: TileLists,
    footprints: NDArray[np.float64],
    shades: F32,
    planes: tuple[F32, F32, F32],
    grid: Grid,
    definition: Definition,
    threads: int,
) -> int:
    """Blend the lists behind what the planes hold already; returns how many tiles can still change."""
    offsets = lists.offsets
    # Ranges of equal work: an entry costs about as much as a twentieth of loading and storing a tile.
    work = offsets + 20 * np.arange(len(offsets))
    parts = 1 if threads == 1 else min(grid.tiles, 16 * threads)
    bounds = np.searchsorted(work, np.linspace(0, work[-1], parts + 1))
    bounds[0], bounds[-1] = 0, grid.tiles
    floor = np.float32(math.log2(definition.alpha_min))
    alpha_max, stop = np.float32(definition.alpha_max), np.float32(definition.stop)
    live = run_ranges(
        lambda first, last: blend_range(
            first, last, grid.columns, offsets, lists.members, footprints, shades, *planes, floor, alpha_max, stop
        ),
        bounds,
        threads,
    )
    return sum(live)


@kernel()
def load_tile(state, colour, transmittance, depth, left, top, columns, rows):
    """Copy a tile's pixels out of the planes; positions outside the image count as finished."""
    state[:] = ZERO
    for row in range(rows):
        for column in range(columns):
            at = row * ROW + column
            state[at] = transmittance[top + row, left + column]
            for channel in range(3):
                state[at + (1 + channel) * TILE] = colour[top + row, left + column, channel]
            state[at + 4 * TILE] = depth[top + row, left + column]


@kernel()
def store_tile(state, colour, transmittance, depth, left, top, columns, rows):
    """Copy a tile's pixels back into the planes."""
    for row in range(rows):
        for column in range(columns):
            at = row * ROW + column
            transmittance[top + row, left + column] = state[at]
            for channel in range(3):
                colour[top + row, left + column, channel] = state[at + (1 + channel) * TILE]
            depth[top + row, left + column] = state[at + 4 * TILE]


@kernel()
def unfinished(state, stop):
    """How many pixels of the tile a further Gaussian can change."""
    count = np.int32(0)
    for row in range(TILE):
        for column in range(TILE):
            count += np.int32(state[np.uint64(row * ROW + column)] > stop)
    return count


@kernel(fastmath=frozenset({"contract"}))
def blend_row(state, start, u1, step1, u2, shear2, log_opacity, red, green, blue, depth, floor, alpha_max, stop):
    """Add one Gaussian to one row of 16 pixels: alpha = min(alpha_max, 2^(log_opacity - u1^2 - u2^2)).

    Every lane does the same work and masks decide, unsigned indices and one flat buffer with constant distances between
    the channels: that is what lets LLVM turn the loop into vectors.
    """
    for column in range(TILE):
        at = np.uint64(start + column)
        ramp = np.float32(column) - CENTRE
        across = u1 + ramp * step1
        down = u2 - ramp * shear2
        power = log_opacity - across * across - down * down
        exponent = power if power > EXPONENT_MIN else EXPONENT_MIN
        whole = np.int32(exponent)  # towards zero, so the rest lies in (-1, 0]
        f = exponent - np.float32(whole)
        value = P0 + f * (P1 + f * (P2 + f * (P3 + f * (P4 + f * P5))))
        bits = np.float32(value).view(np.int32) + np.int32(whole << np.int32(23))
        alpha = np.int32(bits).view(np.float32)
        alpha = alpha if alpha < alpha_max else alpha_max
        light = state[at]
        weight = alpha * light
        weight = weight if power >= floor and light > stop else ZERO
        state[at] = light - weight
        state[at + np.uint64(TILE)] += weight * red
        state[at + np.uint64(2 * TILE)] += weight * green
        state[at + np.uint64(3 * TILE)] += weight * blue
        state[at + np.uint64(4 * TILE)] += weight * depth


@kernel(fastmath=frozenset({"contract"}))
def blend_range(
    first,
    last,
    tile_columns,
    offsets,
    members,
    footprints,
    shades,
    colour,
    transmittance,
    depth,
    floor,
    alpha_max,
    stop,
):
    """Blend the lists of tiles first..last-1; returns how many of them can still change."""
    height, width = transmittance.shape
    state = np.empty(TILE * ROW, np.float32)
    live = 0
    for tile in range(first, last):
        left, top = (tile % tile_columns) * TILE, (tile // tile_columns) * TILE
        columns, rows = min(TILE, width - left), min(TILE, height - top)
        load_tile(state, colour, transmittance, depth, left, top, columns, rows)
        remaining = unfinished(state, stop)
        begin, end = offsets[tile], offsets[tile + 1]
        for entry in range(begin, end):
            if (entry - begin) % CHECK == 0:
                remaining = unfinished(state, stop)
                if remaining == 0:
                    break
            i = members[entry]
            inverse1, k, inverse2 = footprints[i, 2], footprints[i, 3], footprints[i, 4]
            x, y = left + 0.5 * TILE - footprints[i, 0], top + 0.5 * TILE - footprints[i, 1]
            u1, step1 = np.float32(x * inverse1), np.float32(inverse1)
            u2, step2 = np.float32((y - k * x) * inverse2), np.float32(inverse2)
            shear2 = np.float32(k * inverse2)
            half_height = footprints[i, 6]
            row_first = int(max(math.ceil(0.5 * TILE - 0.5 - y - half_height), 0.0))
            row_last = int(min(math.floor(0.5 * TILE - 0.5 - y + half_height), rows - 1.0))
            red, green, blue = shades[i, 0], shades[i, 1], shades[i, 2]
            z, log_opacity = shades[i, 3], shades[i, 4]
            for row in range(row_first, row_last + 1):
                u2_row = u2 + (np.float32(row) - CENTRE) * step2
                blend_row(
                    state,
                    row * ROW,
                    u1,
                    step1,
                    u2_row,
                    shear2,
                    log_opacity,
                    red,
                    green,
                    blue,
                    z,
                    floor,
                    alpha_max,
                    stop,
                )
        store_tile(state, colour, transmittance, depth, left, top, columns, rows)
        live += unfinished(state, stop) > 0
    return live


@kernel(fastmath=frozenset({"contract"}))
def composite_rows(first, last, colour, transmittance, depth, background):
    """Turn the planes of rows first..last-1 into the image: colour over background, opacity, expected depth."""
    for row in range(first, last):
        for column in range(transmittance.shape[1]):
            light = transmittance[row, column]
            alpha = ONE - light
            for channel in range(3):
                colour[row, column, channel] += light * background[channel]
            transmittance[row, column] = alpha
            depth[row, column] = depth[row, column] / alpha if alpha > ZERO else ZERO
