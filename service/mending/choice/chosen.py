"""Depths of unconfirmed pixels, replaced by the candidate that a small network prefers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...matching.guided_filter import GuidedFilter
from ...photographs.images import FittedView
from .candidates import COUNT, Candidates, Matched
from .network import ChoiceNetwork

F64 = NDArray[np.float64]

# Parallax, as a share of the shorter side, from which a pixel outside every other view's picture is not moved away
# unless to a surface that is confirmed nearby with no image edge between: the large network has learned that things
# such as a door frame stand close at the border, where the surfaces behind them seem to continue.
BACK = 1 / 32


def chosen(views: Sequence[FittedView], depths: F64, others: Sequence[F64], network: ChoiceNetwork) -> F64:
    """(V, H, W) z-depths in the cameras' units, from the current `depths` (V, H, W) and two `others`, each (V, H, W):
    the large network's, and those before plane continuation.

    Each pixel takes its candidate (`candidates.py`) with the largest preference, after the preferences were smoothed by
    a guided filter. Confirmed and masked pixels keep their depth, as do views without a confirmed pixel, and pixels
    outside every other view's picture that would move away by BACK or more, unless to a surface nearby.
    """
    matched = Matched(views, depths, others)
    return np.stack([_of_view(matched, index, network) for index in range(len(views))])


def _of_view(matched: Matched, index: int, network: ChoiceNetwork) -> F64:
    """(H, W) z-depths of one view."""
    depth, found = matched.depths[index], matched.candidates(index)
    if found is None:
        return depth
    best = preferred(matched.views[index], found, network)
    inverse, nearby = (np.take_along_axis(each, best[None], axis=0)[0] for each in (found.inverse, found.nearby))
    stays = found.outside & (inverse <= found.inverse[0] - BACK * min(depth.shape)) & ~nearby
    moves = found.undecided & (best > 0) & ~stays
    return np.where(moves, found.disparity_scale / np.where(moves, inverse, 1), depth)


def preferred(view: FittedView, found: Candidates, network: ChoiceNetwork) -> NDArray[np.intp]:
    """(H, W) index of the candidate with the largest smoothed preference; 0 where no preference is near."""
    preferences = np.zeros((COUNT, *found.undecided.shape))
    preferences[:, found.undecided] = network.preferences(found.known, found.about)
    smooth = GuidedFilter(view.grey)
    return np.stack([smooth.of(plane) for plane in preferences]).argmax(axis=0)
