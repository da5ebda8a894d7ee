"""Which pixels two views confirm: their depths lead to each other, and the photographs match there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..photographs.images import FittedView
from .correspondence import PARALLAX_PX, disagreement, parallax, seen_by
from .plane_means import plane_means
from .window_match import contrast, correlations

F64 = NDArray[np.float64]

AGREEMENT_PX = 1.0  # of parallax between a pixel's depth and the other view's own at the place where it is seen
SAME_COLOUR = 0.1  # of a channel, mean over the three; exposures and highlights differ as well
GOOD_MATCH = 0.8  # correlation of the windows about both
TEXTURE = 0.01  # standard deviation of grey in such a window; any depth matches where nothing is to be seen


def confirmed(views: Sequence[FittedView], depths: F64) -> NDArray[np.bool_]:
    """(V, H, W) which pixels at least one other view confirms; `depths` (V, H, W) are z-depths in the cameras' units.

    A pixel, put at its depth, is seen by the other view at a place whose own depth differs by at most AGREEMENT_PX of
    the PARALLAX_PX or more that it has to what is infinitely far, whose colour differs by at most SAME_COLOUR, and
    where windows of 7 x 7 px of both photographs correlate by GOOD_MATCH or more, so far as masks keep them. A window
    without texture confirms nothing, nor does what a mask leaves out.
    """
    found = np.zeros((len(views), *views[0].image.shape[1:]), np.bool_)
    for index, view in enumerate(views):
        grey = view.image.mean(axis=0, dtype=np.float64)
        textured = contrast(grey, view.mask, plane_means) > TEXTURE
        if view.mask is not None:
            textured &= view.mask
        for other, second in enumerate(views):
            if other != index:
                found[index] |= textured & _agrees(view, grey, depths[index], second, depths[other])
    return found


def _agrees(view: FittedView, grey: F64, depth: F64, other: FittedView, other_depth: F64) -> NDArray[np.bool_]:
    """(H, W) where the other view's depth, colour and window are those that the view expects there."""
    seen = seen_by(view, depth, other)
    colour = seen.value(other.image.transpose(1, 2, 0))
    agreed = seen.where & (parallax(view, seen, other) >= PARALLAX_PX)
    agreed &= disagreement(view, seen, other, other_depth) < AGREEMENT_PX
    agreed &= np.abs(colour - view.image.transpose(1, 2, 0)).mean(axis=2) < SAME_COLOUR
    warped = colour.mean(axis=2, dtype=np.float64)
    compared = seen.where if view.mask is None else seen.where & view.mask
    return agreed & (correlations(grey, warped[None], compared[None], plane_means)[0] > GOOD_MATCH)
