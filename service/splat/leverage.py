"""Sensitivity of a picture to each Gaussian: gradient and Gauss-Newton diagonal of a weighted squared error with
respect to its opacity, and its weight and weighted residual for its colour.

Front to back, with C the finished picture, P the colour accumulated up to and including a Gaussian, T the transmittance
in front of it, c its colour, g its falloff and a = o g its alpha, the derivative of a pixel by the opacity o is
    J = dC/do = g (T c - (C - P) / (1 - a)),
since everything behind is attenuated by 1 - a, and that by its colour is its weight T a. This takes the finished
picture and a second pass in the same order.
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

PARTS = 4  # ranges of tiles with separate sums; a fixed number, so that rounding does not depend on the threads
ZERO = np.float32(0.0)


@dataclass(frozen=True, eq=False)
class Leverage:
    """Sums per Gaussian over pixels and channels, with residuals r and pixel weights w; 0 where it is not drawn."""

    slope: NDArray[np.float64]  # (N,) sum w r J: half the gradient of sum w r^2 by the opacity
    moved: NDArray[np.float64]  # (N,) sum w J^2: the Gauss-Newton approximation of half its second derivative
    shown: NDArray[np.float64]  # (N,) sum w T a over pixels: its total weight in the picture, in pixels
    excess: NDArray[np.float64]  # (N, 3) sum w r T a over pixels, per channel

    @classmethod
    def of(cls, count: int) -> Leverage:
        """Zero sums for `count` Gaussians."""
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
    """Render the set over black with its `alpha`, and accumulate the sensitivities of what `judge` returns for it.

    `judge` gets the render, which it may change, and returns the `picture` (H, W, 3) over any background, the
    `residual` (H, W, 3), picture less target, and the `weight` (H, W) of each pixel. Pixels of weight 0 contribute
    nothing, even where their numbers are not finite; where `alpha_max` limits an alpha, the opacity has no effect.
    The sums are added to `onto`, of the same set, where it is given. Results do not depend on the number of threads.
    Raises `InputError` for planes or sums of another size, and as `render` does.
    """
    rule, degree = checked_definition(None, near, None), checked_degree(None, gaussians)
    if onto is not None and len(onto.slope) != len(gaussians):
        raise InputError(f"is of {len(onto.slope)} Gaussians, need {len(gaussians)} as the set", field="onto")
    with sight(gaussians, camera, rule, degree, threads) as view:
        states = _tiled(view, judge(draw(view, ("alpha",), None, checked_background(None))))
        return _weighed(view, states, Leverage.of(len(gaussians)) if onto is None else onto)


def _tiled(view: Sight, given: Planes) -> F32:
    """The judged planes, checked and rearranged as tile states (tiles, floats of a tile)."""
    size = (view.camera.height, view.camera.width)
    for name, plane in zip(("picture", "residual", "weight"), given, strict=True):
        need = size if name == "weight" else (*size, 3)
        if plane.shape != need:
            raise InputError(f"is {plane.shape}, need {need} as the camera's picture", field=name)
    states = np.zeros((view.grid.tiles, tile_floats(CHANNELS)), np.float32)
    with np.errstate(over="ignore"):  # at pixels of weight 0
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
    """Accumulate the parts of the tiles between `bounds` in parallel, and add them to `found` in their order."""
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
    """Fill the zeroed `states` (tiles, floats of a tile); pixels outside the picture and of weight 0 stay 0, without
    transmittance."""
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
    """Traverse the lists of tiles first..last-1, continuing their `states` from the previous batch; adds to `found`
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
