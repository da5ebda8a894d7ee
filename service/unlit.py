"""Black up to the border of a photograph: a backdrop that no light reaches, as far as the scene goes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .confirmed import AGREEMENT_PX, SAME_COLOUR
from .correspondence import from_elsewhere, seen_by
from .images import FittedView

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

BLACK = 0.06  # of every channel, at most
EVEN = 2 / 3  # of what is black up to twice that, this share at least is so up to half of it: things have shades
LEAST_SHARE = 0.02  # of all pixels: less black changes little
CONTRADICTED = 0.015  # share of the black pixels; where depths are right at most 0.011, on generated scenes


def unlit(views: Sequence[FittedView], depths: F64, far: float) -> F64:
    """(V, H, W) z-depths from `depths` (V, H, W), where what is black up to the border of its picture is moved to `far`
    or stays, all of it; in the cameras' units.

    Any depth matches what is black, and the network, which has seen few such photographs, takes one close to what
    stands before it; from elsewhere it then covers that. Dark things are told from a black backdrop by their shades
    (EVEN), and by the other photographs: CONTRADICTED of the black pixels or more must contradict their depths, and no
    more than that share in addition the far end. A pixel contradicts a depth at which another view has it in its
    picture, with another colour there and no surface before it.
    """
    black = _border_black(views, BLACK)
    if black.mean() < LEAST_SHARE or _shaded(views):
        return depths
    moved = np.where(black, np.maximum(depths, far), depths)
    now, then = (_contradicted(views, stack, black) for stack in (depths, moved))
    return moved if now >= CONTRADICTED and then <= now + CONTRADICTED else depths


def _shaded(views: Sequence[FittedView]) -> bool:
    deep, dark = (_border_black(views, level * BLACK).sum() for level in (0.5, 2.0))
    return bool(deep < EVEN * dark)


def _border_black(views: Sequence[FittedView], level: float) -> Mask:
    """(V, H, W) kept pixels of which no channel is above `level`, joined by others to one at the border."""
    return np.stack([_from_border(view.kept & (view.image.max(axis=0) <= level)) for view in views])


def _from_border(black: Mask) -> Mask:
    """(H, W) which of the `black` are joined to one at the border, along rows and columns."""
    found = np.zeros_like(black)
    for edge in (0, -1):
        found[edge], found[:, edge] = black[edge], black[:, edge]
    before = -1
    while (count := int(found.sum())) > before:
        before = count
        found = _along_rows(black, found)
        found = _along_rows(black.T, found.T).T
    return found


def _along_rows(black: Mask, found: Mask) -> Mask:
    """(H, W) with the runs of black pixels in a row of which one is `found`."""
    starts = black.copy()
    starts[:, 1:] &= ~black[:, :-1]
    run = np.cumsum(starts).reshape(black.shape) * black
    hit = np.zeros(int(starts.sum()) + 1, np.bool_)
    hit[run[found & black]] = True
    return black & hit[run]


def _contradicted(views: Sequence[FittedView], depths: F64, black: Mask) -> float:
    """Share of the black pixels whose depth another view contradicts."""
    count = sum(
        int((black[index] & _contradictions(view, index, views, depths)).sum()) for index, view in enumerate(views)
    )
    return count / int(black.sum())


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
