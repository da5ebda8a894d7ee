"""The warning about a given depth range in which the photographs match worse than in the estimated one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.depth_range import DepthRange, depth_range_of_reading
from ..cameras.view_checks import Notice
from ..photographs.images import FittedView
from .coarse_views import CoarseView, nearest_neighbours
from .depth_sweep import narrowed
from .plane_sweep import best_planes
from .window_match import match_weights

AT_END = 0.2  # share of contrast whose best plane is at an end; right ranges of 170 pairs: near <= 0.05, far <= 0.11
END = 2  # planes that count as an end
CURE = (  # they may come from the capture
    "give near and far in the unit of the poses, around the whole scene; where neither the request nor the camera file "
    "has them, they are estimated"
)


def estimated_instead(cameras: Sequence[Camera], depths: DepthRange) -> DepthRange | None:
    """The range as estimated from the cameras; None if `depths` is an estimate already, or none can be made."""
    if depths.source == "estimated":
        return None
    return depth_range_of_reading(cameras, replace(depths, source="estimated"))


def range_doubtful(
    views: Sequence[FittedView],
    coarse: Sequence[CoarseView],
    swept: NDArray[np.float64],
    depths: DepthRange,
    estimate: DepthRange,
    scores: tuple[float, float],
) -> Notice:
    """The warning, with both ranges and the match `scores` in the given and in the estimated one; `swept` (D,) are the
    z-depths of the given range's planes."""
    found, (inside, elsewhere) = narrowed(estimate, views), scores
    message = (
        f"the photographs match with score {inside:.2f} at depths from near = {depths.near:.4g} to far = "
        f"{depths.far:.4g}, and {elsewhere:.2f} where the range is estimated: {found.near:.4g} to {found.far:.4g}"
    )
    at_near, at_far = _at_ends(coarse, swept)
    if max(at_near, at_far) > AT_END:
        share, end, where = (at_near, "near", "nearer") if at_near > at_far else (at_far, "far", "farther")
        message += f"; {100 * share:.0f} % match best at {end}: what they show may be {where}"
    return {"code": "depth_range_doubtful", "field": "near", "message": f"{message} ({CURE})", "score": inside}


def _at_ends(views: Sequence[CoarseView], swept: NDArray[np.float64]) -> tuple[float, float]:
    """Shares, weighted by contrast, of the pixels seen at any plane whose best plane is among the first END, and among
    the last END."""
    near, far, total = 0.0, 0.0, 0.0
    for view, neighbour in zip(views, nearest_neighbours([view.camera for view in views]), strict=True):
        best, depth = best_planes(view, views[neighbour], swept)
        weights = match_weights(view.grey, best, view.kept)
        near += float(weights[depth <= swept[END - 1]].sum())
        far += float(weights[depth >= swept[-END]].sum())
        total += float(weights.sum())
    return (near / total, far / total) if total > 0 else (0.0, 0.0)
