"""Sums of one range of tiles, over the Gaussians whose bounding boxes reach it."""

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
    """Buffers that parts reuse one after the other. Rows that none writes to are never backed by pages, and Gaussians
    that are neighbours in a picture are mostly neighbours in their set."""

    members: NDArray[np.int32]  # (M,)
    sums: NDArray[np.float32]  # (N, SUMS)

    @classmethod
    def of(cls, view: Sight) -> Room:
        """Buffers that hold any part of what is drawn."""
        return cls(np.empty(len(view.projection.drawn), np.int32), np.empty((len(view.gaussians), SUMS), np.float32))


@dataclass(frozen=True, eq=False)
class Part:
    """A range of consecutive tiles and its sums."""

    members: NDArray[np.int32]  # (M,) Gaussians whose boxes reach it
    sums: NDArray[np.float32]  # (N, SUMS); rows of others are undefined

    @classmethod
    def of(cls, view: Sight, room: Room, first: int, last: int) -> Part:
        """The part of tiles first..last-1 with zero sums, in the buffers of `room`, which no other part may use."""
        drawn, boxes = view.projection.drawn, view.projection.space.boxes
        count = list_reaching(drawn, boxes, view.grid.columns, first, last, room.members, room.sums)
        return cls(room.members[:count], room.sums)


@kernel()
def list_reaching(drawn, boxes, columns, first, last, members, sums):
    """Write to `members` those of `drawn` whose box may overlap tiles first..last-1, and zero their `sums` (N, SUMS);
    returns their number."""
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
    """Add the `sums` (N, SUMS) of `members` to the totals, undoing the factors of the opacity."""
    for j in range(members.size):
        i = np.int64(get(members, j))
        opacity, at = np.float64(get(opacities, i)), i * SUMS
        put(slope, i, get(slope, i) + get(sums, at + SLOPE) / opacity)
        put(moved, i, get(moved, i) + get(sums, at + MOVED) / (opacity * opacity))
        put(shown, i, get(shown, i) + get(sums, at + SHOWN))
        for channel in range(3):
            put(excess, 3 * i + channel, get(excess, 3 * i + channel) + get(sums, at + EXCESS + channel))
