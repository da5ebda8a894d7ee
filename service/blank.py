"""Black or white up to the border of a photograph: a backdrop without light or texture, as far as the scene goes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .confirmed import AGREEMENT_PX, SAME_COLOUR
from .correspondence import from_elsewhere, seen_by
from .images import FittedView

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

BLANK = 0.06  # from black or from white, of the channel that is farthest from it
EVEN = 2 / 3  # of what is blank up to twice that, this share at least is so up to half of it: things have shades
LEAST_SHARE = 0.02  # of all pixels: less changes little
CONTRADICTED = 0.015  # share of the blank pixels; where depths are right at most 0.011, on generated scenes


def blank_moved(views: Sequence[FittedView], depths: F64, far: float) -> F64:
    """(V, H, W) z-depths from `depths` (V, H, W), where what is black up to the border of its picture is moved to `far`
    or stays, all of it, and so what is white; in the cameras' units.

    Any depth matches what is blank, and the network may take one close to what stands before it; from elsewhere it then
    covers that. Dark and bright things are told from a backdrop by their shades (EVEN), and by the other photographs:
    CONTRADICTED of the blank pixels or more must contradict their depths, and no more than that share in addition the
    far end. A pixel contradicts a depth at which another view has it in its picture, with another colour there and no
    surface before it.
    """
    from_black = [view.image.max(axis=0) for view in views]
    from_white = [1 - view.image.min(axis=0) for view in views]
    for shades in (from_black, from_white):
        depths = _backdrop_moved(views, shades, depths, far)
    return depths


def _backdrop_moved(views: Sequence[FittedView], shades: Sequence[F32], depths: F64, far: float) -> F64:
    """The same of what is blank where `shades`, (H, W) of each view, are next to 0."""
    blank = _joined(views, shades, BLANK)
    if blank.mean() < LEAST_SHARE:
        return depths
    if _joined(views, shades, BLANK / 2).sum() < EVEN * _joined(views, shades, 2 * BLANK).sum():
        return depths
    moved = np.where(blank, np.maximum(depths, far), depths)
    now, then = (_contradicted(views, stack, blank) for stack in (depths, moved))
    return moved if now >= CONTRADICTED and then <= now + CONTRADICTED else depths


def _joined(views: Sequence[FittedView], shades: Sequence[F32], level: float) -> Mask:
    """(V, H, W) kept pixels of at most that shade, joined by others to one at the border."""
    return np.stack([_from_border(view.kept & (shade <= level)) for view, shade in zip(views, shades, strict=True)])


def _from_border(blank: Mask) -> Mask:
    """(H, W) which of the `blank` are joined to one at the border, along rows and columns."""
    found = np.zeros_like(blank)
    for edge in (0, -1):
        found[edge], found[:, edge] = blank[edge], blank[:, edge]
    before = -1
    while (count := int(found.sum())) > before:
        before = count
        found = _along_rows(blank, found)
        found = _along_rows(blank.T, found.T).T
    return found


def _along_rows(blank: Mask, found: Mask) -> Mask:
    """(H, W) with the runs of blank pixels in a row of which one is `found`."""
    starts = blank.copy()
    starts[:, 1:] &= ~blank[:, :-1]
    run = np.cumsum(starts).reshape(blank.shape) * blank
    hit = np.zeros(int(starts.sum()) + 1, np.bool_)
    hit[run[found & blank]] = True
    return blank & hit[run]


def _contradicted(views: Sequence[FittedView], depths: F64, blank: Mask) -> float:
    """Share of the blank pixels whose depth another view contradicts."""
    count = sum(
        int((blank[index] & _contradictions(view, index, views, depths)).sum()) for index, view in enumerate(views)
    )
    return count / int(blank.sum())


def _contradictions(view: FittedView, index: int, views: Sequence[FittedView], depths: F64) -> Mask:
    """(H, W) where at least one other view does."""
    found, colours = np.zeros(depths[index].shape, np.bool_), view.image.transpose(1, 2, 0)
    for other, way in from_elsewhere(views, index, depths[index]).items():
        seen = seen_by(view, depths[index], views[other])
        theirs = seen.value((1 / depths[other])[..., None])[..., 0]
        before = (theirs - 1 / seen.z) * way > AGREEMENT_PX
        differs = np.abs(seen.value(views[other].image.transpose(1, 2, 0)) - colours).mean(axis=2) > SAME_COLOUR
        found |= seen.where & differs & ~before
    return found
