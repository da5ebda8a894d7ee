"""Masks that outline what a scene consists of: nothing of a sheet may be seen in what they leave out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import pixel_grid
from ..photographs.images import FittedView

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH = 8  # px around a point that a mask must keep: a cell of the backdrop spreads by 5 px (standard deviation)
KEPT = 0.95  # share of these: single pixels that a mask lacks do not count
STRAY = 0.25  # of the share of its picture that an outline leaves out: most of the other views' pixels that fall there
STRIDE = 4  # px between these


def clear_of_masks(points: F64, owner: NDArray[np.intp], views: Sequence[FittedView], depths: F64) -> Mask:
    """(N,) whether nothing of a sheet would stand in what a mask leaves out.

    `points` (N, 3) are its Gaussians in the world, `owner` (N,) the views that they belong to, `depths` (V, H, W)
    z-depths of the views' pixels. A point must project to where the mask of its own view keeps KEPT of the pixels
    within REACH, and likewise in every other view that shows it and whose mask is an outline.

    A mask is an outline, such as that of an object cut out of its background, if the other views have little where it
    leaves pixels out: of their kept pixels that it shows, at most STRAY times the share of its picture that lies there.
    A passer-by who is masked in one photograph hides what others show; behind him a sheet may stand. So it may at bars:
    masks that keep a whole rectangle say nothing about the scene.
    """
    clear = np.ones(len(points), dtype=np.bool_)
    for index, view in enumerate(views):
        if view.mask is None or _is_rectangle(view.mask):
            continue
        others = [place for place in range(len(views)) if place != index]
        judged = owner == index
        if _is_outline(view, [views[place] for place in others], depths[others]):
            judged = np.ones_like(judged)
        kept, inside = _at(view, kept_around(view.kept, REACH), points)
        clear &= ~judged | ~inside | (kept >= KEPT)
    return clear


def kept_around(kept: Mask, reach: int) -> F64:
    """(H, W) which share of the pixels within `reach` of each along both axes is `kept`, of those in the picture."""
    return _sums(kept.astype(np.float64), reach) / _sums(np.ones(kept.shape), reach)


def _sums(values: F64, reach: int) -> F64:
    """(H, W) sums of `values` (H, W) within `reach` along both axes."""
    side = 2 * reach + 1
    sums = np.pad(np.pad(values, reach).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]


def _is_rectangle(kept: Mask) -> bool:
    rows, columns = np.flatnonzero(kept.any(axis=1)), np.flatnonzero(kept.any(axis=0))
    return len(rows) > 0 and bool(kept[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all())


def _is_outline(view: FittedView, others: Sequence[FittedView], depths: F64) -> bool:
    """Whether the kept pixels of the others, at their `depths`, hardly fall at least REACH beside what `view` keeps;
    not where nothing lies so far beside it."""
    strays, shown = 0, 0
    far = kept_around(view.kept, REACH) <= 0
    if not far.any():
        return False
    for other, depth in zip(others, depths, strict=True):
        some = np.s_[::STRIDE, ::STRIDE]
        chosen = other.kept[some]
        pixels = pixel_grid(depth.shape).reshape(*depth.shape, 2)[some][chosen]
        stray, inside = _at(view, far, other.camera.unproject(pixels, depth[some][chosen]))
        strays, shown = strays + int((stray & inside).sum()), shown + int(inside.sum())
    return strays <= STRAY * float(far.mean()) * shown


def _at(view: FittedView, values: NDArray, points: F64) -> tuple[NDArray, Mask]:
    """(N,) of `values` (H, W) at the pixels to which points (N, 3) project, and (N,) whether the view shows them. Where
    two pixels meet, as in the middle of a cell, it is the one before, whatever the rounding."""
    pixels, z = view.camera.project(points)
    inside = view.camera.shows(pixels, z)
    column, row = np.maximum(np.where(inside[:, None], pixels, 0.0) - 0.25, 0.0).astype(np.intp).T
    return values[row, column], inside
