"""Sums of a part of the tiles: of those Gaussians alone whose boxes may reach it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .access import get, put
from .kernel_cache import kernel
from .leverage_lanes import EXCESS, MOVED, SHOWN, SLOPE, SUMS
from .sight import Sight
from .spans import unpacked_box


@dataclass(frozen=True, eq=False)
class Room:
    """Where what is found in a part goes. Of each part in turn: what no part writes to is memory that no page backs,
    and Gaussians that stand together in a picture stand together in their set."""

    members: NDArray[np.int32]  # (M,)
    sums: NDArray[np.float32]  # (N, SUMS)

    @classmethod
    def of(cls, view: Sight) -> Room:
        """Of any part of what is drawn."""
        return cls(np.empty(len(view.projection.drawn), np.int32), np.empty((len(view.gaussians), SUMS), np.float32))


@dataclass(frozen=True, eq=False)
class Part:
    """Some tiles of a picture, one after the other, and what is found there."""

    members: NDArray[np.int32]  # (M,) whose boxes may reach it
    sums: NDArray[np.float32]  # (N, SUMS), of others undefined

    @classmethod
    def of(cls, view: Sight, room: Room, first: int, last: int) -> Part:
        """Of tiles first..last-1, with sums of 0, in a `room` that nobody else uses."""
        drawn, boxes = view.projection.drawn, view.projection.space.boxes
        count = list_reaching(drawn, boxes, view.grid.columns, first, last, room.members, room.sums)
        return cls(room.members[:count], room.sums)


@kernel()
def list_reaching(drawn, boxes, columns, first, last, members, sums):
    """List in `members` those of `drawn` whose box may hold a tile of first..last-1, with `sums` (N, SUMS) of 0;
    returns how many."""
    count = 0
    for j in range(drawn.size):
        i = np.int64(get(drawn, j))
        left, right, top, bottom = unpacked_box(get(boxes, i))
        if top * columns + left < last and bottom * columns + right >= first:
            put(members, count, i)
            count += 1
            for n in range(SUMS):
                put(sums, SUMS * i + n, np.float32(0.0))
    return count


@kernel()
def add_part(members, sums, opacities, slope, moved, shown, excess):
    """Add the `sums` (N, SUMS) of `members`, by the unit that each is in."""
    for j in range(members.size):
        i = np.int64(get(members, j))
        opacity, at = np.float64(get(opacities, i)), i * SUMS
        put(slope, i, get(slope, i) + get(sums, at + SLOPE) / opacity)
        put(moved, i, get(moved, i) + get(sums, at + MOVED) / (opacity * opacity))
        put(shown, i, get(shown, i) + get(sums, at + SHOWN))
        for channel in range(3):
            put(excess, 3 * i + channel, get(excess, 3 * i + channel) + get(sums, at + EXCESS + channel))
