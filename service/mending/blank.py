"""Black or white up to the border of a photograph: a backdrop without light or texture, as far as the scene goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..matching.confirmed import AGREEMENT_PX, SAME_COLOUR
from ..matching.correspondence import from_elsewhere, seen_by
from ..photographs.from_border import from_border
from ..photographs.images import FittedView

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

BLANK = 0.06  # from black or from white, of the channel that is farthest from it
EVEN = 2 / 3  # of what is blank up to twice that, this share at least is so up to half of it: things have shades
FALL = 0.5  # of the contradictions, to at most so much where that share is reached only above a backdrop's own level
LEAST_SHARE = 0.02  # of all pixels: less changes little
CONTRADICTED = 0.015  # share of the blank pixels; on generated scenes, whose backdrops are found right, at most 0.011
ROUNDED = 1e-6  # of a depth, when it has been float32


def blank_moved(views: Sequence[FittedView], depths: F64, far: float) -> F64:
    """(V, H, W) z-depths from `depths` (V, H, W), where what is black up to the border of its picture is moved to `far`
    or stays, all of it, and so what is white; in the cameras' units.

    Any depth matches what is blank, and the network may take one close to what stands before it; from elsewhere it then
    covers that. Dark and bright things are told from a backdrop by their shades (EVEN), and by the other photographs:
    CONTRADICTED of the blank pixels or more must contradict their depths, and no more than that share in addition the
    far end. A backdrop that is lifted or noisy is even from its own level on, the median along the border, up to half
    of BLANK; then the far end must contradict at most FALL of what the depths do. A pixel contradicts a depth at which
    another view has it in its picture, with another colour there and no surface before it. What stands close and is
    evenly black, such as a window frame against the light, goes as well where its depths are contradicted.
    """
    for shades in _shades(views):
        depths = _backdrop_moved(views, shades, depths, far)
    return depths


def blank_held(views: Sequence[FittedView], before: F64, after: F64, far: float) -> F64:
    """(V, H, W) z-depths `after` a step, but as `before` it where what is blank up to the border stood at `far`."""
    blank = np.logical_or(*(_joined(views, shades, BLANK) for shades in _shades(views)))
    return np.where(blank & (before >= far * (1 - ROUNDED)), before, after)


def _shades(views: Sequence[FittedView]) -> tuple[Sequence[F32], Sequence[F32]]:
    """(H, W) of each view: how far the channel that is farthest is from black, and from white."""
    return [view.image.max(axis=0) for view in views], [1 - view.image.min(axis=0) for view in views]


def _backdrop_moved(views: Sequence[FittedView], shades: Sequence[F32], depths: F64, far: float) -> F64:
    """The same of what is blank where `shades`, (H, W) of each view, are next to 0."""
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
    ways = [from_elsewhere(views, index, depth) for index, depth in enumerate(depths)]
    now, then = (_contradicted(views, ways, stack, blank) for stack in (depths, moved))
    return moved if now >= CONTRADICTED and then <= (now + CONTRADICTED if plain else FALL * now) else depths


def _border_level(shades: Sequence[F32], joined: Mask) -> float:
    """Median shade of the `joined` pixels (V, H, W) along the borders of the pictures."""
    border = np.ones_like(joined)
    border[:, 1:-1, 1:-1] = False
    return float(np.median(np.stack(shades)[joined & border]))


def _joined(views: Sequence[FittedView], shades: Sequence[F32], level: float) -> Mask:
    """(V, H, W) kept pixels of at most that shade, joined by others to one at the border."""
    return np.stack([from_border(view.kept & (shade <= level)) for view, shade in zip(views, shades, strict=True)])


def _contradicted(views: Sequence[FittedView], ways: Sequence[Mapping[int, float]], depths: F64, blank: Mask) -> float:
    """Share of the blank pixels whose depth another view contradicts; `ways` to others as of `from_elsewhere`."""
    found = [_contradictions(views, index, ways[index], depths) for index in range(len(views))]
    return int((blank & np.stack(found)).sum()) / int(blank.sum())


def _contradictions(views: Sequence[FittedView], index: int, ways: Mapping[int, float], depths: F64) -> Mask:
    """(H, W) where at least one other view does."""
    found, colours = np.zeros(depths[index].shape, np.bool_), views[index].image.transpose(1, 2, 0)
    for other, way in ways.items():
        seen = seen_by(views[index], depths[index], views[other])
        theirs = seen.value((1 / depths[other])[..., None])[..., 0]
        before = (theirs - 1 / seen.z) * way > AGREEMENT_PX
        differs = np.abs(seen.value(views[other].image.transpose(1, 2, 0)) - colours).mean(axis=2) > SAME_COLOUR
        found |= seen.where & differs & ~before
    return found
