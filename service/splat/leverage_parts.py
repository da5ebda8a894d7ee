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
class Part:
    """Some tiles of a picture, one after the other, and what is found there."""

    first: int  # of the tiles
    members: NDArray[np.int32]  # (M,) whose boxes may reach it
    ranks: NDArray[np.int32]  # (N,) where each stands among them; of the others undefined
    sums: NDArray[np.float32]  # (M, SUMS)

    @classmethod
    def of(cls, view: Sight, first: int, last: int) -> Part:
        """Of tiles first..last-1, with sums of 0."""
        ranks, members = np.empty(len(view.gaussians), np.int32), np.empty(len(view.projection.drawn), np.int32)
        boxes = view.projection.space.boxes
        count = list_reaching(view.projection.drawn, boxes, view.grid.columns, first, last, ranks, members)
        return cls(first, members[:count].copy(), ranks, np.zeros((count, SUMS), np.float32))


@kernel()
def list_reaching(drawn, boxes, columns, first, last, ranks, members):
    """List in `members` those of `drawn` whose box may hold a tile of first..last-1, and in `ranks` (N,) where each
    stands there; returns how many."""
    count = 0
    for j in range(drawn.size):
        i = np.int64(get(drawn, j))
        left, right, top, bottom = unpacked_box(get(boxes, i))
        if top * columns + left < last and bottom * columns + right >= first:
            put(ranks, i, count)
            put(members, count, i)
            count += 1
    return count


@kernel()
def add_part(members, sums, opacities, slope, moved, shown, excess):
    """Add the sums (M, SUMS) of `members`, by the unit that each is in."""
    for rank in range(members.size):
        i, at = np.int64(get(members, rank)), rank * SUMS
        opacity = np.float64(get(opacities, i))
        put(slope, i, get(slope, i) + get(sums, at + SLOPE) / opacity)
        put(moved, i, get(moved, i) + get(sums, at + MOVED) / (opacity * opacity))
        put(shown, i, get(shown, i) + get(sums, at + SHOWN))
        for channel in range(3):
            put(excess, 3 * i + channel, get(excess, 3 * i + channel) + get(sums, at + EXCESS + channel))
