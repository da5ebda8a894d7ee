"""Blank backdrops: black or white regions that reach the border of a photograph, moved to the far end of the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..matching.confirmed import AGREEMENT_PX, SAME_COLOUR
from ..matching.correspondence import reprojected, views_with_parallax
from ..photographs.from_border import from_border
from ..photographs.images import FittedView

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

BLANK = 0.06  # largest distance of any channel from black, or from white
EVEN = 2 / 3  # least share of pixels within twice BLANK that are within half of it: objects have shading
FALL = 0.5  # contradictions left at the far end, at most, if EVEN is reached only above a backdrop's own level
LEAST_SHARE = 0.02  # of all pixels: less changes little
CONTRADICTED = 0.015  # share of the blank pixels; on generated scenes, whose backdrops are found right, at most 0.011
ROUNDED = 1e-6  # of a depth, when it has been float32


def blank_moved(views: Sequence[FittedView], depths: F64, far: float) -> F64:
    """(V, H, W) z-depths in the cameras' units: `depths` (V, H, W) with black regions that reach the border of their
    picture moved to `far`, all of them or none, and likewise white ones.

    A blank region matches at any depth, and the network may place it close to the object in front of it, which it then
    occludes in other views. Two tests tell a backdrop from dark and bright objects. It is even: at least EVEN of the
    pixels within twice BLANK are within half of it, counted from black or white or, for a lifted or noisy backdrop,
    from its own level: the median along the border, up to half of BLANK. And the other photographs contradict its
    depths, in a share of CONTRADICTED or more, but not the far end: there at most CONTRADICTED more, or, if it is only
    even from its own level, at most FALL times as many. A pixel is contradicted where another view sees its point with
    another colour and no surface in front of it. An evenly black object close by, such as a window frame against the
    light, moves as well if its depths are contradicted.
    """
    for shades in _shades(views):
        depths = _backdrop_moved(views, shades, depths, far)
    return depths


def blank_held(views: Sequence[FittedView], before: F64, after: F64, far: float) -> F64:
    """(V, H, W) z-depths `after` a step, except where a blank region that reaches the border was at `far` `before`."""
    blank = np.logical_or(*(_joined(views, shades, BLANK) for shades in _shades(views)))
    return np.where(blank & (before >= far * (1 - ROUNDED)), before, after)


def _shades(views: Sequence[FittedView]) -> tuple[Sequence[F32], Sequence[F32]]:
    """Per view (H, W): the largest distance of a channel from black; and likewise from white."""
    return [view.image.max(axis=0) for view in views], [1 - view.image.min(axis=0) for view in views]


def _backdrop_moved(views: Sequence[FittedView], shades: Sequence[F32], depths: F64, far: float) -> F64:
    """As `blank_moved`, for the regions in which `shades`, (H, W) per view, are near 0."""
    blank = _joined(views, shades, BLANK)
    if blank.mean() < LEAST_SHARE:
        return depths
    shaded = _joined(views, shades, 2 * BLANK)
    level = min(_border_level(shades, shaded), BLANK / 2)
    enough = EVEN * shaded.sum()
    plain, even = (_joined(views, shades, above + BLANK / 2).sum() >= enough for above in (0.0, level))
    if not even:
        return depths
    moved = np.where(blank, np.maximum(depths, far), depths)
    scales = [views_with_parallax(views, index, depth) for index, depth in enumerate(depths)]
    now, then = (_contradicted(views, scales, stack, blank) for stack in (depths, moved))
    return moved if now >= CONTRADICTED and then <= (now + CONTRADICTED if plain else FALL * now) else depths


def _border_level(shades: Sequence[F32], joined: Mask) -> float:
    """Median shade of the `joined` pixels (V, H, W) along the borders of the pictures."""
    border = np.ones_like(joined)
    border[:, 1:-1, 1:-1] = False
    return float(np.median(np.stack(shades)[joined & border]))


def _joined(views: Sequence[FittedView], shades: Sequence[F32], level: float) -> Mask:
    """(V, H, W) kept pixels of a shade of at most `level`, connected to the border of their picture by such pixels."""
    return np.stack([from_border(view.kept & (shade <= level)) for view, shade in zip(views, shades, strict=True)])


def _contradicted(
    views: Sequence[FittedView], scales: Sequence[Mapping[int, float]], depths: F64, blank: Mask
) -> float:
    """Share of the blank pixels (V, H, W) whose depth another view contradicts; `scales` are `views_with_parallax` per
    view."""
    found = [_contradictions(views, index, scales[index], depths) for index in range(len(views))]
    return int((blank & np.stack(found)).sum()) / int(blank.sum())


def _contradictions(views: Sequence[FittedView], index: int, scales: Mapping[int, float], depths: F64) -> Mask:
    """(H, W) pixels of view `index` whose depth at least one other view contradicts."""
    found, colours = np.zeros(depths[index].shape, np.bool_), views[index].image.transpose(1, 2, 0)
    for other, scale in scales.items():
        seen = reprojected(views[index], depths[index], views[other])
        theirs = seen.value((1 / depths[other])[..., None])[..., 0]
        before = (theirs - 1 / seen.z) * scale > AGREEMENT_PX
        differs = np.abs(seen.value(views[other].image.transpose(1, 2, 0)) - colours).mean(axis=2) > SAME_COLOUR
        found |= seen.where & differs & ~before
    return found
