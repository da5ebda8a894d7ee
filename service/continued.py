"""Depths that no other view confirms, on the surfaces that go on from confirmed pixels where photographs match better.

A wall or a floor goes on where its texture ends, or where one view alone shows it. The inverse depth of a plane is
linear in the pixel's position, so that what is confirmed about it tells the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .confirmed import confirmed
from .correspondence import seen_by
from .images import FittedView
from .match_cost import GAIN, NOTHING, Gathering, difference, features
from .plane_kernels import spread_along_rows, spread_down_columns

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACHES = (6.0, 24.0)  # px: standard deviations of the weight of confirmed pixels, where no edge lies between
EDGE = 0.2  # sum over a change in the three channels that is as far as a reach is
RIDGE = 0.02  # of the reach squared: variance of positions below which slopes fade
SURE_MATCH = 0.05  # of a difference: below it a place is found again that the other view does not see as it is
LEAST = 1e-9  # weight below which nothing that is confirmed is near


def continued(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths, from those of the network, in the cameras' units.

    For each unconfirmed pixel (`confirmed.py`) and each of REACHES a plane is fitted to the inverse depths of the
    confirmed ones, by least squares, weighted by their distance along rows and columns in which edges lengthen the
    way (domain transform, Gastal and Oliveira 2011). Its inverse depth, within the range of the view, is taken where
    another photograph differs less there than at the depth as it is (`match_cost.py`), by GAIN and by NOTHING more; of
    several that with the largest gain. At a depth at which that photograph does not see the pixel it would differ by
    SURE_MATCH. What is confirmed, what a mask leaves out and a view without a confirmed pixel stay.
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
    planes = [_planes(view, inverse, sure, kept, reach) for reach in REACHES]
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


def _planes(view: FittedView, inverse: F64, sure: Mask, kept: Mask, reach: float) -> F64:
    """(H, W) inverse depth of the plane through the confirmed pixels about each, within the range of the `kept`."""
    y, x = (np.arange(count, dtype=np.float64) for count in inverse.shape)
    y, one, d = y[:, None], np.ones((1, 1)), inverse
    terms = ((one, one), (x, one), (y, one), (x, x), (x, y), (y, y), (d, one), (d, x), (d, y))
    steps = _steps(view.image, 2, reach), _steps(view.image, 1, reach)
    mass, mean_x, mean_y, xx, xy, yy, level, xd, yd = (_spread(a * b * sure, *steps) for a, b in terms)
    known, ridge = mass > LEAST, RIDGE * reach**2
    for total in (mean_x, mean_y, xx, xy, yy, level, xd, yd):  # all in place: of a finer grid this is much memory
        total /= np.maximum(mass, LEAST)
    for spread, mean in ((xx, mean_x), (yy, mean_y)):
        spread -= mean**2
        np.maximum(spread, 0, out=spread)
        spread += ridge
    xy -= mean_x * mean_y
    xd -= mean_x * level
    yd -= mean_y * level
    across, down = yy * xd - xy * yd, xx * yd - xy * xd
    found = level + (across * (x - mean_x) + down * (y - mean_y)) / (xx * yy - xy**2)
    return np.where(known, np.clip(found, inverse[kept].min(), inverse[kept].max()), inverse)


def _spread(plane: F64, across: F64, down: F64) -> F64:
    """(H, W) weighted sums of `plane` over the pixels about each, along its row, then along columns, where `across`
    (H, W - 1) and `down` (H - 1, W) are what a step multiplies a weight by."""
    along, sums = np.empty_like(plane[None]), np.empty_like(plane[None])
    spread_along_rows(plane[None], across, along)
    spread_down_columns(along, down, sums)
    return sums[0]


def _steps(picture: NDArray[np.floating], axis: int, reach: float) -> F64:
    """(H, W - 1) or (H - 1, W) what a step to the next pixel of a row or column of (3, H, W) multiplies a weight by:
    exp(-sqrt(2) d / reach) for a way d, in which a change of EDGE counts like `reach` px."""
    change = np.abs(np.diff(picture.astype(np.float64), axis=axis)).sum(axis=0)
    return np.ascontiguousarray(np.exp(-np.sqrt(2) / reach * (1 + reach / EDGE * change)))
