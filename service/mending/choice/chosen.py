"""Depths that no other view confirms, moved to the candidate that a small network prefers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...matching.guided_filter import GuidedFilter
from ...photographs.images import FittedView
from .candidates import COUNT, Candidates, Matched
from .network import ChoiceNetwork

F64 = NDArray[np.float64]

# Parallax, of the shorter side, by which a pixel that no other view has in its picture does not move away: that
# something stands close at the border, such as a door frame, the large network has learned, while surfaces behind it
# seem to go on.
BACK = 1 / 32


def chosen(views: Sequence[FittedView], depths: F64, others: Sequence[F64], network: ChoiceNetwork) -> F64:
    """(V, H, W) z-depths, from `depths` (V, H, W) and two `others`, the network's own and those before planes, in the
    cameras' units.

    Of the candidates of each pixel (`candidates.py`) the one with the largest preference, once preferences are smoothed
    within surfaces by a guided filter. What is confirmed, what a mask leaves out and a view without a confirmed pixel
    stay, and so does what no other view has in its picture and would move away by BACK or more.
    """
    matched = Matched(views, depths, others)
    return np.stack([_of_view(matched, index, network) for index in range(len(views))])


def _of_view(matched: Matched, index: int, network: ChoiceNetwork) -> F64:
    """(H, W) of one view."""
    depth, found = matched.depths[index], matched.candidates(index)
    if found is None:
        return depth
    best = preferred(matched.views[index], found, network)
    inverse = np.take_along_axis(found.inverse, best[None], axis=0)[0]
    stays = found.outside & (inverse <= found.inverse[0] - BACK * min(depth.shape))
    moves = found.undecided & (best > 0) & ~stays
    return np.where(moves, found.way / np.where(moves, inverse, 1), depth)


def preferred(view: FittedView, found: Candidates, network: ChoiceNetwork) -> NDArray[np.intp]:
    """(H, W) place of the candidate that each undecided pixel and those about it prefer."""
    preferences = np.zeros((COUNT, *found.undecided.shape))
    preferences[:, found.undecided] = network.preferences(found.known, found.about)
    smooth = GuidedFilter(view.image.mean(axis=0, dtype=np.float64))
    return np.stack([smooth.of(plane) for plane in preferences]).argmax(axis=0)
