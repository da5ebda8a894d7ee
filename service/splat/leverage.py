"""What each opacity does to a picture: the slope of the squared residual along it, and how far it moves the picture.

Front to back, with C the finished picture, P what has been added up to and with a Gaussian, T the transmittance before
it, c its colour, g its falloff and a = o g its alpha, a pixel changes with the opacity o by
    J = dC/do = g (T c - (C - P) / (1 - a)),
since all that lies behind shines through 1 - a. That needs the finished picture and one more pass in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..gaussians import Gaussians
from .access import get, put, smaller
from .binning import TILE, Grid, tile_lists
from .blend import PIECE, choose, gather, measure_reach
from .kernel_cache import kernel
from .leverage_lanes import CHANNELS, SUMS, leverage_block
from .options import checked_definition, checked_degree, checked_size
from .order import depth_order
from .prepare import prepared
from .project import project
from .tile_state import ACROSS, BLOCKS, corner, live_blocks, tile_floats
from .vectors import ENTRY, SIDE

F32 = NDArray[np.float32]
ZERO = np.float32(0.0)


@dataclass(frozen=True, eq=False)
class Leverage:
    """Sums over the pixels and channels of one picture, per Gaussian; 0 where it is not drawn."""

    slope: NDArray[np.float64]  # (N,) sum r J: half the slope of the sum of r^2
    moved: NDArray[np.float64]  # (N,) sum J^2: the square of how far the picture moves


def leverage(
    gaussians: Gaussians,
    camera: Camera,
    picture: NDArray[np.floating],
    residual: NDArray[np.floating],
    counted: NDArray[np.bool_],
    *,
    near: float | None = None,
) -> Leverage:
    """`picture` (H, W, 3) is what `render` draws, over any background; `residual` (H, W, 3) is what it has too much.

    Pixels that are not `counted` (H, W) add nothing, nor does a Gaussian at a pixel where `alpha_max` holds its alpha.
    Runs on one thread; the bits depend on the arguments alone. Raises `InputError` as `render` does.
    """
    rule, degree = checked_definition(None, near, None), checked_degree(None, gaussians)
    grid = checked_size(camera)
    states = _tiles(np.dstack([counted, picture, residual]).astype(np.float32), grid)
    cuts = np.array([rule.alpha_max, rule.stop], np.float32)
    slope, moved = np.zeros(len(gaussians)), np.zeros(len(gaussians))
    scene = prepared(gaussians, 1)
    with scene.workspace() as space:
        projection = project(scene, camera, rule, degree, 1, space)
        order = depth_order(space.depths, projection.drawn, gaussians)
        narrow = space.records.view(np.float32)
        for lists in tile_lists(projection, order, grid, rule.max_entries, 1):
            leverage_tiles(
                grid.columns, lists.offsets, lists.members, space.records, narrow, states, cuts, slope, moved
            )  # fmt: skip
    opacities = np.maximum(gaussians.opacities.astype(np.float64), rule.alpha_min)  # fainter ones are not drawn
    return Leverage(slope / opacities, moved / opacities**2)


def _tiles(planes: F32, grid: Grid) -> F32:
    """(H, W, CHANNELS) -> (tiles, floats of a tile), 0 outside the picture: such pixels have no light."""
    whole = np.zeros((grid.rows * TILE, grid.columns * TILE, CHANNELS), np.float32)
    whole[: grid.height, : grid.width] = planes
    blocks = whole.reshape(grid.rows, ACROSS, SIDE, grid.columns, ACROSS, SIDE, CHANNELS)
    return np.ascontiguousarray(blocks.transpose(0, 3, 1, 4, 6, 2, 5)).reshape(grid.tiles, tile_floats(CHANNELS))


@kernel()
def leverage_tiles(columns, offsets, members, records, narrow, states, cuts, slope, moved):
    """Walk the lists of all tiles, whose `states` go on where the batch before ended; adds to slope and moved (N,)."""
    entries = np.empty(PIECE * ENTRY, np.float32)
    fields = np.empty(10 * PIECE, np.float32)
    reach, sums = np.empty(PIECE, np.float32), np.zeros(SUMS * PIECE, np.float32)
    chosen = np.empty(PIECE + 1, np.int32)
    alpha_max, stop = get(cuts, 0), get(cuts, 1)
    for tile in range(offsets.size - 1):
        left, top = (tile % columns) * TILE, (tile // columns) * TILE
        state = states[tile]
        begin, end = get(offsets, tile), get(offsets, tile + 1)
        for piece in range(begin, end, PIECE):
            live = live_blocks(state, stop)
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
                at = block * (state.size // BLOCKS)
                leverage_block(entries, chosen, kept, x0, y0, state, at, alpha_max, stop, sums)
            for j in range(count):
                member = np.int64(get(members, piece + j))
                put(slope, member, get(slope, member) + get(sums, SUMS * j))
                put(moved, member, get(moved, member) + get(sums, SUMS * j + 1))
                put(sums, SUMS * j, ZERO)
                put(sums, SUMS * j + 1, ZERO)
