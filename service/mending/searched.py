"""Depths that no other view confirms, searched over the whole range of the scene where photographs match far better.

The network sees windows of few pixels at half the resolution and may settle on a wrong surface altogether, which a
pixel of parallax to either side (`refined.py`) does not mend.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cameras.rotations import turned
from ..matching.coarse_views import pixel_grid
from ..matching.confirmed import AGREEMENT_PX, TEXTURE, confirmed
from ..matching.correspondence import disagreement, from_elsewhere, seen_by
from ..matching.match_cost import GAIN, LIMIT, NOTHING, Gathering, difference, features
from ..matching.plane_kernels import compare_level
from ..matching.plane_means import plane_means
from ..matching.window_match import contrast
from ..photographs.images import FittedView
from ..splat.parallel import checked_threads, run_ranges

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP_PX = 1.0  # of parallax between two levels, about, in the view that is farthest away
LEVELS = 160  # at most, in wider steps; up to 640 gave no better pictures
TAIL = 0.001  # of the inverse depths at either end, which may be the network's worst
ROOM = 0.1  # of an inverse depth, by which the range goes on beyond them
OTHERS = 3  # that a view is compared with, those of least parallax: all six views would take 30 comparisons
TIED = 1e-6  # of a way: views as near as the last of them are compared as well, whatever their order
PAIR_PX = 16.0  # that a depth moves at most where all others are from one place: farther, repetitions cost as much


class _Best(NamedTuple):
    """Where a view matches best."""

    depth: F64  # (H, W) z-depth
    gains: Mask  # (H, W) by GAIN and by NOTHING more than at the depth as it is


def searched(views: Sequence[FittedView], depths: F64, threads: int | None = None) -> F64:
    """(V, H, W) z-depths, from those of the network, in the cameras' units.

    Each view is compared with the nearest ones from elsewhere (`match_cost.py`) at levels of inverse depth, STEP_PX
    apart, over the range of all `depths`; the least of the gathered costs over the others counts, so that a surface is
    found that one of them sees. It is taken by textured pixels that nothing confirms (`confirmed.py`), where it is less
    than GAIN times that of the depth as it is, by NOTHING more, and where the place that it leads to in one of the
    others has a depth or a best level within AGREEMENT_PX of it. Where the others are all from one place it must lie
    within PAIR_PX. What a mask leaves out stays. `threads` (all that are available) do not change a bit.
    """
    inverse = 1 / depths[np.stack([view.kept for view in views])]
    places = [from_elsewhere(views, index, depth) for index, depth in enumerate(depths)]
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
        for other, way in elsewhere[index].items():
            seen = seen_by(view, found.depth, views[other])
            close = [
                disagreement(view, seen, views[other], theirs) < AGREEMENT_PX
                for theirs in (depths[other], best[other].depth)
            ]
            near = np.abs(1 / found.depth - 1 / depths[index]) * way < PAIR_PX
            agreed |= seen.where & (close[0] | close[1]) & (near | (not pair))
        textured = contrast(view.image.mean(axis=0, dtype=np.float64), view.mask, plane_means) > TEXTURE
        taken = found.gains & agreed & textured & view.kept & ~sure[index]
        result[index] = np.where(taken, found.depth, depths[index])
    return result


def _nearest(elsewhere: dict[int, float]) -> dict[int, float]:
    """OTHERS of them, and those as near as the last."""
    last = sorted(elsewhere.values())[:OTHERS][-1:]
    return {other: way for other, way in elsewhere.items() if last and way <= (1 + TIED) * last[0]}


def _best(
    views: Sequence[FittedView],
    pictures: Sequence[F32],
    depth: F64,
    index: int,
    elsewhere: dict[int, float],
    ends: tuple[float, float],
) -> _Best:
    """Of the view `index`, whose z-depths are `depth` (H, W), over inverse depths between the `ends`; `pictures` are
    the features of all views, `elsewhere` has those that it is compared with, and px of parallax per unit of 1/z."""
    view, own = views[index], pictures[index]
    kept = view.kept
    steps = np.ceil((ends[1] - ends[0]) * max(elsewhere.values()) / STEP_PX)
    levels = np.linspace(*ends, int(np.clip(steps, 2, LEVELS)))
    sweeps = [_Sweep.of(view, own, views[other], pictures[other]) for other in elsewhere]
    gathering = Gathering(view, kept)
    least, chosen = np.full(depth.shape, np.inf), np.zeros(depth.shape)
    for level in levels:
        cost = reduce(np.minimum, [gathering.of(sweep.cost(level) * kept) for sweep in sweeps])
        chosen[cost < least] = level
        np.minimum(least, cost, out=least)
    as_it_is = [difference(view, own, depth, views[other], pictures[other]) for other in elsewhere]
    now = reduce(np.minimum, [gathering.of(cost * kept) for cost in as_it_is])
    return _Best(1 / chosen, least < GAIN * now - NOTHING)


class _Sweep(NamedTuple):
    """What it takes to compare a view with another one."""

    own: F32  # (H, W, C) features
    others: F32  # (h, w, C), NaN where a mask hides it
    rays: F64  # (H, W, 3) of the view's pixels, in the axes of the other view
    way: F64  # (3,) from the other view's centre to that of the view, in the same axes
    lens: F64  # (4,) of the other view

    @classmethod
    def of(cls, view: FittedView, own: F32, other: FittedView, others: F32) -> _Sweep:
        camera, shape = other.camera, view.image.shape[1:]
        return cls(
            own,
            np.where(other.kept[..., None], others, np.float32(np.nan)),
            turned(camera.rotation.T, view.camera.rays(pixel_grid(shape))).reshape(*shape, 3),
            camera.rotation.T @ (view.camera.center - camera.center),
            np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        )

    def cost(self, level: float) -> F64:
        """(H, W) mean absolute difference at the inverse z-depth `level`; LIMIT at most, and where not seen."""
        found = np.empty(self.own.shape[:2])
        compare_level(self.own, self.others, self.rays, self.way, self.lens, level, LIMIT, found)
        return found
