"""Depths moved to where the photographs match best, within a pixel of parallax.

The network decides on a depth at half the resolution of the photographs and matches small windows; here the whole
pictures are compared, edges included, close to what it found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .correspondence import disagreement, pixels_per_inverse_depth, seen_by
from .images import FittedView
from .window_match import window_mean

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

OFFSETS_PX = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of parallax, in the view that is farthest away
VISIBLE_PX = 3.0  # between the depths of both views; beyond, the other one sees something else
GRADIENT = 6.0  # weight of a difference of grey slopes (per px) beside one of a colour's channel
LIMIT = 0.25  # of the mean difference, from which two places are as different as can be
RADIUS, EPSILON = 2, 1e-3  # px and variance of grey of the guided filter: weaker edges are smoothed across
SEEN = 0.05  # share of a window that must be seen for its costs to count in full
LEAST_WAY = 0.05  # between two views, of the longest: another from nearly the same place tells nothing of depth
GAIN = 0.9  # of the cost of the depth as it is; what gains less stays
NOTHING = 1e-4  # of a difference, a fortieth of an 8-bit level: what gains less stays as well
RANGE = 2.0  # most by which a depth changes: with little parallax a pixel of it is all there is


def refined(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths, from those of the network, in the cameras' units.

    For each of OFFSETS_PX a pixel is compared with where the other views would see it: mean absolute difference of
    colours and of the slopes of grey, LIMIT at most, over the views whose own depth there lies within VISIBLE_PX. The
    costs are gathered within surfaces by a guided filter (He et al. 2010; on cost volumes: Hosni et al. 2011); the
    least of them is refined by a parabola, and taken if it is less than GAIN times that of the depth as it is, by
    NOTHING more. What no other view sees and what a mask leaves out stays as it is; a view from nearly the same place
    (LEAST_WAY) is not compared.
    """
    features = [_features(view) for view in views]
    return np.stack([_of_view(views, features, depths, index) for index in range(len(views))])


def _of_view(views: Sequence[FittedView], features: Sequence[F32], depths: F64, index: int) -> F64:
    view, inverse = views[index], 1 / depths[index]
    others = [other for other in range(len(views)) if other != index]
    moves = {other: pixels_per_inverse_depth(view, views[other]) for other in others}
    pixels = max(moves.values())
    if pixels == 0:
        return depths[index]
    steps = [np.clip(inverse + offset / pixels, inverse / RANGE, inverse * RANGE) for offset in OFFSETS_PX]
    total, counted = np.zeros((len(OFFSETS_PX), *inverse.shape)), np.zeros(inverse.shape)
    for other in (other for other in others if moves[other] >= LEAST_WAY * pixels):
        seen = seen_by(view, depths[index], views[other])
        visible = seen.where & (disagreement(view, seen, views[other], depths[other]) < VISIBLE_PX)
        if view.mask is not None:
            visible &= view.mask
        if visible.any():
            counted += visible
            for cost, step in zip(total, steps, strict=True):
                there = seen_by(view, 1 / step, views[other])
                apart = np.abs(there.value(features[other]) - features[index]).mean(axis=2)
                cost += visible * np.where(there.where, np.minimum(apart, LIMIT), LIMIT)
    known = counted > 0
    grey = view.image.mean(axis=0, dtype=np.float64)
    share = np.maximum(_guided(grey, known[None].astype(np.float64)), SEEN)
    gathered = np.maximum(_guided(grey, total / np.maximum(counted, 1)) / share, 0)  # the filter undershoots
    offset, gains = _least(gathered)
    moved = np.clip(inverse + offset / pixels, inverse / RANGE, inverse * RANGE)
    return np.where(known & gains, 1 / moved, depths[index])


def _least(costs: F64) -> tuple[F64, NDArray[np.bool_]]:
    """(H, W) the offset of the least of (D, H, W) costs, between the steps, in px; and whether it gains enough."""
    best = costs.argmin(axis=0)[None]
    inner = np.clip(best, 1, len(costs) - 2)
    before, at, after = (np.take_along_axis(costs, inner + step, axis=0)[0] for step in (-1, 0, 1))
    bend = before - 2 * at + after
    vertex = np.where((inner == best)[0] & (bend > 0), 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    step = OFFSETS_PX[1] - OFFSETS_PX[0]
    offset = OFFSETS_PX[0] + step * (best[0] + np.clip(vertex, -0.5, 0.5))
    as_it_is = costs[OFFSETS_PX.index(0.0)]
    return offset, np.take_along_axis(costs, best, axis=0)[0] < GAIN * as_it_is - NOTHING


def _features(view: FittedView) -> F32:
    """(H, W, 5) the colours and the slopes of grey across and down, 0 at the border and beside masked pixels."""
    grey = view.image.mean(axis=0)
    kept = np.ones(grey.shape, np.bool_) if view.mask is None else view.mask
    slopes = np.zeros((2, *grey.shape), np.float32)
    slopes[0, :, 1:-1] = (kept[:, 2:] & kept[:, :-2]) * (grey[:, 2:] - grey[:, :-2]) / 2
    slopes[1, 1:-1] = (kept[2:] & kept[:-2]) * (grey[2:] - grey[:-2]) / 2
    return np.ascontiguousarray(np.concatenate([view.image, np.float32(GRADIENT) * slopes]).transpose(1, 2, 0))


def _guided(guide: F64, planes: F64) -> F64:
    """Guided filter of every plane (D, H, W) by the picture (H, W)."""
    mean = window_mean(guide, RADIUS)
    variance = window_mean(guide**2, RADIUS) - mean**2
    level = window_mean(planes, RADIUS)
    slope = (window_mean(guide * planes, RADIUS) - mean * level) / (variance + EPSILON)
    return window_mean(slope, RADIUS) * guide + window_mean(level - slope * mean, RADIUS)
