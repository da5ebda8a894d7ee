"""Global depth search: unconfirmed pixels move to any depth of the scene at which the photographs match far better.

The network matches small windows at half the resolution and may settle on a wrong surface altogether, which a local
refinement by a pixel of parallax (`refined.py`) cannot correct.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import pixel_grid
from ..cameras.rotations import rotated
from ..matching.confirmed import AGREEMENT_PX, confirmed, textured
from ..matching.correspondence import disagreement, reprojected, views_with_parallax
from ..matching.match_cost import GAIN, LIMIT, NOTHING, CostAggregation, difference, features
from ..matching.reprojection_kernels import compare_level
from ..photographs.images import FittedView
from ..splat.parallel import checked_threads, run_ranges

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP_PX = 1.0  # of parallax between levels, about, in the compared view with the longest baseline
LEVELS = 160  # at most, then with wider steps; up to 640 gave no better pictures
TAIL = 0.001  # quantile of the inverse depths ignored at either end: outliers
ROOM = 0.1  # of these quantiles, by which the range extends beyond them
OTHERS = 3  # views that each is compared with, of the least parallax: all pairs of six views would be 30
TIED = 1e-6  # relative: views tied with the last of these are compared as well, so that their order does not matter
PAIR_PX = 16.0  # largest move if all others are from one place: farther away, repeated texture matches as well


class _Best(NamedTuple):
    """The best level of each pixel of a view."""

    depth: F64  # (H, W) z-depth
    gains: Mask  # (H, W) whether its cost is below GAIN times that of the current depth, by a margin of NOTHING


def searched(views: Sequence[FittedView], depths: F64, threads: int | None = None) -> F64:
    """(V, H, W) z-depths in the cameras' units, from `depths` (V, H, W).

    Each view is compared with the nearest ones that have parallax to it, at levels of inverse depth STEP_PX apart over
    the range of all `depths`. A level's cost is the least of the aggregated costs (`match_cost.py`) over these views,
    so that one view that sees the surface suffices. A pixel takes its best level if it is textured and unconfirmed
    (`confirmed.py`), if the cost gains enough (`_Best`), and if one of the views has, where the pixel reprojects, a
    depth or a best level within AGREEMENT_PX. If the views compared with are all from one place, it must also lie
    within PAIR_PX of the current depth. Masked pixels keep their depth. The bits do not depend on `threads` (default:
    all).
    """
    inverse = 1 / depths[np.stack([view.kept for view in views])]
    places = [views_with_parallax(views, index, depth) for index, depth in enumerate(depths)]
    elsewhere = [_nearest(apart) for apart in places]
    if not inverse.size or not all(elsewhere):
        return depths.copy()
    low, high = np.quantile(inverse, (TAIL, 1 - TAIL))
    ends = (1 - ROOM) * float(low), (1 + ROOM) * float(high)
    pictures = [features(view) for view in views]

    def of_view(index: int, _: int) -> _Best:
        return _best(views, pictures, depths[index], index, elsewhere[index], ends)

    best = run_ranges(of_view, range(len(views) + 1), checked_threads(threads))
    sure = confirmed(views, depths)
    result = depths.copy()
    for index, view in enumerate(views):
        found, agreed = best[index], np.zeros(sure[index].shape, np.bool_)
        pair = not any(second in places[first] for first in elsewhere[index] for second in elsewhere[index])
        for other, scale in elsewhere[index].items():
            seen = reprojected(view, found.depth, views[other])
            close = [
                disagreement(view, seen, views[other], theirs) < AGREEMENT_PX
                for theirs in (depths[other], best[other].depth)
            ]
            near = np.abs(1 / found.depth - 1 / depths[index]) * scale < PAIR_PX
            agreed |= seen.where & (close[0] | close[1]) & (near | (not pair))
        taken = found.gains & agreed & textured(view) & ~sure[index]
        result[index] = np.where(taken, found.depth, depths[index])
    return result


def _nearest(elsewhere: dict[int, float]) -> dict[int, float]:
    """The OTHERS of least parallax, and those tied with the last of them."""
    last = sorted(elsewhere.values())[:OTHERS][-1:]
    return {other: scale for other, scale in elsewhere.items() if last and scale <= (1 + TIED) * last[0]}


def _best(
    views: Sequence[FittedView],
    pictures: Sequence[F32],
    depth: F64,
    index: int,
    elsewhere: dict[int, float],
    ends: tuple[float, float],
) -> _Best:
    """The best levels of view `index` between the `ends` of inverse depth; `depth` (H, W) are its current z-depths,
    `pictures` the features of all views, and `elsewhere` maps the views that it is compared with to px per unit of
    1/z."""
    view, own = views[index], pictures[index]
    kept = view.kept
    steps = np.ceil((ends[1] - ends[0]) * max(elsewhere.values()) / STEP_PX)
    levels = np.linspace(*ends, int(np.clip(steps, 2, LEVELS)))
    sweeps = [_Sweep.of(view, own, views[other], pictures[other]) for other in elsewhere]
    aggregation = CostAggregation(view, kept)
    least, chosen = np.full(depth.shape, np.inf), np.zeros(depth.shape)
    for level in levels:
        cost = reduce(np.minimum, [aggregation.of(sweep.cost(level) * kept) for sweep in sweeps])
        chosen[cost < least] = level
        np.minimum(least, cost, out=least)
    as_it_is = [difference(view, own, depth, views[other], pictures[other]) for other in elsewhere]
    now = reduce(np.minimum, [aggregation.of(cost * kept) for cost in as_it_is])
    return _Best(1 / chosen, least < GAIN * now - NOTHING)


class _Sweep(NamedTuple):
    """A plane sweep of one view against another."""

    own: F32  # (H, W, C) features
    others: F32  # (h, w, C) features of the other view, NaN where it is masked
    rays: F64  # (H, W, 3) of the view's pixels, in the axes of the other view
    baseline: F64  # (3,) from the other view's centre to the view's, in the same axes
    lens: F64  # (4,) fx, fy, cx, cy of the other view, px

    @classmethod
    def of(cls, view: FittedView, own: F32, other: FittedView, others: F32) -> _Sweep:
        camera, shape = other.camera, view.image.shape[1:]
        return cls(
            own,
            np.where(other.kept[..., None], others, np.float32(np.nan)),
            rotated(camera.rotation.T, view.camera.rays(pixel_grid(shape))).reshape(*shape, 3),
            camera.rotation.T @ (view.camera.center - camera.center),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        )

    def cost(self, level: float) -> F64:
        """(H, W) mean absolute difference at the inverse z-depth `level`, truncated at LIMIT; LIMIT where not seen."""
        found = np.empty(self.own.shape[:2])
        compare_level(self.own, self.others, self.rays, self.baseline, self.lens, level, LIMIT, found)
        return found
