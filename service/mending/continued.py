"""Depths that no other view confirms, on surfaces through confirmed pixels where photographs match better there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..matching.confirmed import confirmed
from ..matching.correspondence import seen_by
from ..matching.match_cost import GAIN, NOTHING, Gathering, difference, features
from ..photographs.images import FittedView
from .surfaces import surface

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACHES = (6.0, 24.0)  # px, of a `surface`
SURE_MATCH = 0.05  # of a difference: below it a place is found again that the other view does not see as it is


def continued(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths, from those of the network, in the cameras' units.

    For each unconfirmed pixel (`confirmed.py`) and each of REACHES there is a plane through the confirmed ones about it
    (`surfaces.py`). Its inverse depth, within the range of the view, is taken where another photograph differs less
    there than at the depth as it is (`match_cost.py`), by GAIN and by NOTHING more; of several that with the largest
    gain. At a depth at which that photograph does not see the pixel it would differ by SURE_MATCH. What is confirmed,
    what a mask leaves out and a view without a confirmed pixel stay.
    """
    sure, pictures = confirmed(views, depths), [features(view) for view in views]
    found = [_of_view(views, pictures, depths[index], index, sure[index]) for index in range(len(views))]
    return np.where(sure, depths, np.stack(found))


def _of_view(views: Sequence[FittedView], pictures: Sequence[F32], depth: F64, index: int, sure: Mask) -> F64:
    """(H, W) z-depths of the view `index`, with `depth` as they are and `sure` which are confirmed (H, W)."""
    if not sure.any():
        return depth
    view = views[index]
    kept = view.kept
    inverse = 1 / depth
    planes = [surface(view.image, inverse, sure, reach).within(inverse, kept) for reach in REACHES]
    gathering = Gathering(view, kept)
    least, chosen = np.full(inverse.shape, GAIN), depth
    for other in (other for other in range(len(views)) if other != index):

        def cost(depths: F64, at: int = other) -> F64:
            return gathering.of(kept * difference(view, pictures[index], depths, views[at], pictures[at]))

        now = cost(1 / inverse)
        now = np.where(seen_by(view, depth, views[other]).where, now, np.minimum(now, SURE_MATCH))
        now = np.maximum(now, NOTHING)
        for plane in planes:
            share = (cost(1 / plane) + NOTHING) / now
            better = kept & (share < least)
            least, chosen = np.where(better, share, least), np.where(better, 1 / plane, chosen)
    return chosen
