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
from .match_cost import GAIN, NOTHING, difference, features, gathered
from .plane_kernels import spread_along_rows, spread_down_columns

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
    sure = confirmed(views, depths)
    pictures = [features(view) for view in views]
    result = depths.copy()
    for index, view in enumerate(views):
        if not sure[index].any():
            continue
        kept = np.ones(sure[index].shape, np.bool_) if view.mask is None else view.mask
        inverse = 1 / depths[index]
        surfaces = [inverse, *(_planes(view, inverse, sure[index], kept, reach) for reach in REACHES)]
        least, best = np.full(inverse.shape, GAIN), np.zeros(inverse.shape, np.intp)
        for other in (other for other in range(len(views)) if other != index):
            seen = seen_by(view, depths[index], views[other]).where
            apart = [difference(view, pictures[index], 1 / s, views[other], pictures[other]) for s in surfaces]
            costs = gathered(view, np.where(kept, np.stack(apart), 0.0), kept)
            now = np.where(seen, costs[0], np.minimum(costs[0], SURE_MATCH))
            for number in range(1, len(surfaces)):
                share = (costs[number] + NOTHING) / np.maximum(now, NOTHING)
                better = kept & (share < least)
                least, best = np.where(better, share, least), np.where(better, number, best)
        chosen = 1 / np.take_along_axis(np.stack(surfaces), best[None], axis=0)[0]
        result[index] = np.where((best > 0) & ~sure[index], chosen, depths[index])
    return result


def _planes(view: FittedView, inverse: F64, sure: Mask, kept: Mask, reach: float) -> F64:
    """(H, W) inverse depth of the plane through the confirmed pixels about each, within the range of the `kept`."""
    y, x = np.mgrid[: inverse.shape[0], : inverse.shape[1]].astype(np.float64)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, inverse, inverse * x, inverse * y])
    sums = _spread(terms * sure, view.image, reach)
    mass = np.maximum(sums[0], LEAST)
    mean_x, mean_y, xx, xy, yy, level, xd, yd = sums[1:] / mass
    ridge = RIDGE * reach**2
    xx, yy = np.maximum(xx - mean_x**2, 0) + ridge, np.maximum(yy - mean_y**2, 0) + ridge
    xy, xd, yd = xy - mean_x * mean_y, xd - mean_x * level, yd - mean_y * level
    across, down = yy * xd - xy * yd, xx * yd - xy * xd
    found = level + (across * (x - mean_x) + down * (y - mean_y)) / (xx * yy - xy**2)
    return np.where(sums[0] > LEAST, np.clip(found, inverse[kept].min(), inverse[kept].max()), inverse)


def _spread(planes: F64, picture: NDArray[np.floating], reach: float) -> F64:
    """(K, H, W) weighted sums of `planes` over the pixels about each: exp(-sqrt(2) d / reach) for a way d along a row,
    then along a column, in which a change of EDGE in `picture` (3, H, W) counts like `reach` px."""
    planes, steps = np.ascontiguousarray(planes), picture.astype(np.float64)
    along, sums = np.empty_like(planes), np.empty_like(planes)
    spread_along_rows(planes, _steps(steps, 2, reach), along)
    spread_down_columns(along, _steps(steps, 1, reach), sums)
    return sums


def _steps(picture: F64, axis: int, reach: float) -> F64:
    """(H, W - 1) or (H - 1, W) what a step to the next pixel of a row or column multiplies a weight by."""
    change = np.abs(np.diff(picture, axis=axis)).sum(axis=0)
    return np.ascontiguousarray(np.exp(-np.sqrt(2) / reach * (1 + reach / EDGE * change)))
