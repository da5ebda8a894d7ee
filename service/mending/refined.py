"""Local depth refinement: each pixel moves to where the photographs match best, within a pixel of parallax.

The network estimates depth at half the resolution of the photographs and matches small windows; here costs at full
resolution are aggregated with respect to edges, close to the depth that it found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..matching.correspondence import disagreement, reprojected, views_with_parallax
from ..matching.match_cost import GAIN, NOTHING, CostAggregation, difference, features
from ..photographs.images import FittedView

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

OFFSETS_PX = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of parallax, in the other view with the longest baseline
VISIBLE_PX = 3.0  # of parallax between both views' depths; beyond it the pixel is occluded in the other view
RANGE = 2.0  # largest factor by which a depth changes: with little parallax a pixel of it may span the whole range


def refined(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths in the cameras' units, from `depths` (V, H, W).

    For each of OFFSETS_PX the matching cost (`match_cost.py`) is averaged over the other views in which the pixel is
    visible: whose own depth there lies within VISIBLE_PX. The minimum of the aggregated costs, interpolated by a
    parabola, is taken if it is below GAIN times the cost of the current depth, by a margin of NOTHING. Masked pixels
    and those visible in no other view keep their depth. Views without parallax are left out (`views_with_parallax`).
    """
    pictures = [features(view) for view in views]
    return np.stack([_of_view(views, pictures, depths, index) for index in range(len(views))])


def _of_view(views: Sequence[FittedView], pictures: Sequence[F32], depths: F64, index: int) -> F64:
    """(H, W) z-depths of view `index`, from the `features` of all views and their z-depths (V, H, W)."""
    view, inverse = views[index], 1 / depths[index]
    others = views_with_parallax(views, index, depths[index])
    if not others:
        return depths[index]
    scale = max(others.values())
    steps = [np.clip(inverse + offset / scale, inverse / RANGE, inverse * RANGE) for offset in OFFSETS_PX]
    total, counted = np.zeros((len(OFFSETS_PX), *inverse.shape)), np.zeros(inverse.shape)
    for other in others:
        seen = reprojected(view, depths[index], views[other])
        visible = view.kept & seen.where & (disagreement(view, seen, views[other], depths[other]) < VISIBLE_PX)
        if visible.any():
            counted += visible
            for cost, step in zip(total, steps, strict=True):
                cost += visible * difference(view, pictures[index], 1 / step, views[other], pictures[other])
    known = counted > 0
    aggregation = CostAggregation(view, known)
    for cost in total:
        cost[:] = aggregation.of(cost / np.maximum(counted, 1))
    offset, gains = _least(total)
    moved = np.clip(inverse + offset / scale, inverse / RANGE, inverse * RANGE)
    return np.where(known & gains, 1 / moved, depths[index])


def _least(costs: F64) -> tuple[F64, NDArray[np.bool_]]:
    """(H, W) offset in px of the minimum of `costs` (D, H, W), to sub-step precision, and (H, W) whether it gains
    enough over the current depth."""
    best = costs.argmin(axis=0)[None]
    inner = np.clip(best, 1, len(costs) - 2)
    before, at, after = (np.take_along_axis(costs, inner + step, axis=0)[0] for step in (-1, 0, 1))
    bend = before - 2 * at + after
    vertex = np.where((inner == best)[0] & (bend > 0), 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    step = OFFSETS_PX[1] - OFFSETS_PX[0]
    offset = OFFSETS_PX[0] + step * (best[0] + np.clip(vertex, -0.5, 0.5))
    as_it_is = costs[OFFSETS_PX.index(0.0)]
    return offset, np.take_along_axis(costs, best, axis=0)[0] < GAIN * as_it_is - NOTHING
