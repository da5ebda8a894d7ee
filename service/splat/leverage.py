"""What each Gaussian does to a picture: by its opacity, the slope of a weighted square sum along it and how far it
moves the picture; by its colour, how much of the picture it is and what the pixels that show it have too much.

Front to back, with C the finished picture, P what has been added up to and with a Gaussian, T the transmittance before
it, c its colour, g its falloff and a = o g its alpha, a pixel changes with the opacity o by
    J = dC/do = g (T c - (C - P) / (1 - a)),
since all that lies behind shines through 1 - a, and with its colour by its share T a. That needs the finished picture
and one more pass in the same order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .access import get, put, smaller
from .binning import TILE, TileLists
from .blend import PIECE, choose, gather, measure_reach
from .kernel_cache import kernel
from .leverage_lanes import CHANNELS, LIGHT, RESIDUAL, REST, SUMS, WEIGHT, leverage_block
from .leverage_parts import Part, Room, add_part
from .options import checked_background, checked_definition, checked_degree
from .parallel import run_ranges
from .render import Render, draw
from .sight import Sight, sight
from .tile_state import BLOCKS, corner, live_blocks, place, tile_floats
from .vectors import ENTRY, PIXELS

F32 = NDArray[np.float32]
Planes = tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]

PARTS = 4  # of the tiles, each with sums of its own, always the same: threads take parts, and change no rounding
ZERO = np.float32(0.0)


@dataclass(frozen=True, eq=False)
class Leverage:
    """Sums over the pixels and channels of pictures, per Gaussian; 0 where it is not drawn."""

    slope: NDArray[np.float64]  # (N,) sum w r J: half the slope of the sum of w r^2
    moved: NDArray[np.float64]  # (N,) sum w J^2: the square of how far the picture moves
    shown: NDArray[np.float64]  # (N,) sum w T a over the pixels: how many pixels it is, by weight
    excess: NDArray[np.float64]  # (N, 3) sum w r T a over the pixels, of each channel

    @classmethod
    def of(cls, count: int) -> Leverage:
        """Of no picture yet."""
        return cls(np.zeros(count), np.zeros(count), np.zeros(count), np.zeros((count, 3)))


def leverage(
    gaussians: Gaussians,
    camera: Camera,
    judge: Callable[[Render], Planes],
    *,
    near: float | None = None,
    threads: int | None = None,
    onto: Leverage | None = None,
) -> Leverage:
    """Draw the set over black and weigh what `judge` makes of the image, which is its own and has its `alpha`: the
    `picture` (H, W, 3) as it is over any background, `residual` (H, W, 3), what it has too much, and `weight` (H, W),
    what a pixel counts.

    A pixel of weight 0 adds nothing, whatever its numbers, nor does an opacity at a pixel where `alpha_max` holds the
    alpha. What is found is added to `onto`, of the same set, where one is given: sums over several pictures. The bits
    do not depend on the number of threads. Raises `InputError` for planes or sums of another size, and as `render`
    does.
    """
    rule, degree = checked_definition(None, near, None), checked_degree(None, gaussians)
    if onto is not None and len(onto.slope) != len(gaussians):
        raise InputError(f"is of {len(onto.slope)} Gaussians, need {len(gaussians)} as the set", field="onto")
    with sight(gaussians, camera, rule, degree, threads) as view:
        states = _tiled(view, judge(draw(view, ("alpha",), None, checked_background(None))))
        return _weighed(view, states, Leverage.of(len(gaussians)) if onto is None else onto)


def _tiled(view: Sight, given: Planes) -> F32:
    """(tiles, floats of a tile) what was judged, which itself needs no memory from now on."""
    size = (view.camera.height, view.camera.width)
    for name, plane in zip(("picture", "residual", "weight"), given, strict=True):
        need = size if name == "weight" else (*size, 3)
        if plane.shape != need:
            raise InputError(f"is {plane.shape}, need {need} as the camera's picture", field=name)
    states = np.zeros((view.grid.tiles, tile_floats(CHANNELS)), np.float32)
    with np.errstate(over="ignore"):  # at pixels that do not count
        # One layout for every caller: numba would compile the kernel again for others.
        planes = [np.require(plane, np.float32, ["C", "W"]) for plane in given]
    fill_tiles(*planes, view.grid.columns, states)
    return states


def _weighed(view: Sight, states: F32, found: Leverage) -> Leverage:
    edges = [len(states) * part // PARTS for part in range(PARTS + 1)]
    at_once = PARTS if view.several else min(view.threads, PARTS)  # several batches of lists are made anew each time
    rooms = [Room.of(view) for _ in range(at_once)]
    for start in range(0, PARTS, at_once):
        _add_parts(view, states, edges[start : start + at_once + 1], rooms, found)
    return found


def _add_parts(view: Sight, states: F32, bounds: Sequence[int], rooms: Sequence[Room], found: Leverage) -> None:
    """What is found in the parts of the tiles between `bounds`, added in their order."""
    cuts = np.array([view.definition.alpha_max, view.definition.stop], np.float32)
    opacities = np.require(view.gaussians.opacities, np.float32, ["C", "W"])
    # By the first tile; of few tiles some parts are empty, and the last parts may be fewer than there is room for.
    own = {first: room for (first, last), room in zip(pairwise(bounds), rooms, strict=False) if first < last}
    parts = run_ranges(lambda first, last: Part.of(view, own[first], first, last), bounds, view.threads)
    found_in = dict(zip(own, parts, strict=True))
    for lists in view.lists():
        run_ranges(partial(_walk_part, lists, view, states, cuts, found_in), bounds, view.threads)
    for part in parts:
        add_part(part.members, part.sums, opacities, found.slope, found.moved, found.shown, found.excess)


def _walk_part(
    lists: TileLists, view: Sight, states: F32, cuts: F32, parts: Mapping[int, Part], first: int, last: int
) -> None:
    records = view.projection.space.records
    entries = (view.grid.columns, lists.offsets, lists.members, records, records.view(np.float32))
    leverage_tiles(first, last, *entries, states, cuts, parts[first].sums)


@kernel()
def fill_tiles(picture, residual, weight, columns, states):
    """Into `states` (tiles, floats of a tile), 0 at first: they stay 0 outside the picture and where nothing counts,
    as such pixels have no light."""
    height, width = weight.shape
    size = states.shape[1]
    for y in range(height):
        for x in range(width):
            pixel = y * width + x
            counts = get(weight, pixel)
            if not counts > ZERO:
                continue
            at = ((y // TILE) * columns + x // TILE) * size + place(y % TILE, x % TILE, size)
            put(states, at + LIGHT * PIXELS, np.float32(1.0))
            put(states, at + WEIGHT * PIXELS, counts)
            for channel in range(3):
                put(states, at + (REST + channel) * PIXELS, get(picture, 3 * pixel + channel))
                put(states, at + (RESIDUAL + channel) * PIXELS, get(residual, 3 * pixel + channel) * counts)


@kernel()
def leverage_tiles(first, last, columns, offsets, members, records, narrow, states, cuts, found):
    """Walk the lists of tiles first..last-1, whose `states` go on where the batch before ended; adds to found
    (N, SUMS)."""
    entries = np.empty(PIECE * ENTRY, np.float32)
    fields = np.empty(10 * PIECE, np.float32)
    reach, sums = np.empty(PIECE, np.float32), np.zeros(SUMS * PIECE, np.float32)
    chosen = np.empty(PIECE + 1, np.int32)
    alpha_max, stop = get(cuts, 0), get(cuts, 1)
    for tile in range(first, last):
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
                for n in range(SUMS):
                    put(found, SUMS * member + n, get(found, SUMS * member + n) + get(sums, SUMS * j + n))
                    put(sums, SUMS * j + n, ZERO)
