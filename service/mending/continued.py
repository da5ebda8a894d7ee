"""Plane continuation: unconfirmed pixels move to planes through confirmed ones where the photographs match better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..matching.confirmed import confirmed
from ..matching.correspondence import reprojected
from ..matching.match_cost import GAIN, NOTHING, CostAggregation, difference, features
from ..photographs.images import FittedView
from .surfaces import surface

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACHES = (6.0, 24.0)  # px, of a `surface`
SURE_MATCH = 0.05  # cost of the current depth where the other view does not see it: a plane must match better


def continued(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths in the cameras' units, from `depths` (V, H, W).

    For each unconfirmed pixel (`confirmed.py`) and each of REACHES a plane is fitted through the confirmed pixels
    around it (`surfaces.py`); its inverse depth is clipped to the range of the view. The pixel takes it where the
    matching cost with another view (`match_cost.py`) is below GAIN times that of its current depth, by a margin of
    NOTHING; of several, the one with the largest relative gain. Where the other view does not see the pixel at its
    current depth, that costs at most SURE_MATCH. Confirmed and masked pixels keep their depth, as do views without a
    confirmed pixel.
    """
    sure, pictures = confirmed(views, depths), [features(view) for view in views]
    found = [_of_view(views, pictures, depths[index], index, sure[index]) for index in range(len(views))]
    return np.where(sure, depths, np.stack(found))


def _of_view(views: Sequence[FittedView], pictures: Sequence[F32], depth: F64, index: int, sure: Mask) -> F64:
    """(H, W) z-depths of view `index`, from the current `depth` (H, W) and the mask `sure` (H, W) of confirmed ones."""
    if not sure.any():
        return depth
    view = views[index]
    kept = view.kept
    inverse = 1 / depth
    planes = [surface(view.image, inverse, sure, reach).within(inverse, kept) for reach in REACHES]
    aggregation = CostAggregation(view, kept)
    least, chosen = np.full(inverse.shape, GAIN), depth
    for other in (other for other in range(len(views)) if other != index):

        def cost(depths: F64, at: int = other) -> F64:
            return aggregation.of(kept * difference(view, pictures[index], depths, views[at], pictures[at]))

        now = cost(1 / inverse)
        now = np.where(reprojected(view, depth, views[other]).where, now, np.minimum(now, SURE_MATCH))
        now = np.maximum(now, NOTHING)
        for plane in planes:
            share = (cost(1 / plane) + NOTHING) / now
            better = kept & (share < least)
            least, chosen = np.where(better, share, least), np.where(better, 1 / plane, chosen)
    return chosen
