"""Cross-view consistency: pixels whose depth and colour agree with those of another view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..photographs.images import FittedView
from .correspondence import PARALLAX_PX, disagreement, parallax, reprojected
from .plane_means import plane_means
from .window_match import contrast, correlations

F64 = NDArray[np.float64]

AGREEMENT_PX = 1.0  # of parallax between a pixel's depth and the other view's depth where the pixel reprojects
SAME_COLOUR = 0.1  # mean absolute difference of the channels; exposures and highlights differ as well
GOOD_MATCH = 0.8  # normalised cross-correlation of the two windows
TEXTURE = 0.01  # standard deviation of grey in a window; below it any depth matches


def confirmed(views: Sequence[FittedView], depths: F64) -> NDArray[np.bool_]:
    """(V, H, W) pixels that at least one other view confirms; `depths` (V, H, W) are z-depths in the cameras' units.

    Another view confirms a pixel if, where the pixel reprojects at its depth, (1) it has at least PARALLAX_PX of
    parallax against infinity, (2) the view's own depth differs by less than AGREEMENT_PX of parallax, (3) the colour
    differs by less than SAME_COLOUR, and (4) the 7 x 7 px windows of both photographs correlate by more than
    GOOD_MATCH. Masked pixels and windows without texture are never confirmed.
    """
    found = np.zeros((len(views), *views[0].image.shape[1:]), np.bool_)
    for index, view in enumerate(views):
        matchable = textured(view)
        for other, second in enumerate(views):
            if other != index:
                found[index] |= matchable & _agrees(view, depths[index], second, depths[other])
    return found


def textured(view: FittedView) -> NDArray[np.bool_]:
    """(H, W) kept pixels whose windows have texture."""
    return view.kept & (contrast(view.grey, view.kept, plane_means) > TEXTURE)


def _agrees(view: FittedView, depth: F64, other: FittedView, other_depth: F64) -> NDArray[np.bool_]:
    """(H, W) where `other` confirms `view`, by the z-depths (H, W) of both."""
    seen = reprojected(view, depth, other)
    colour = seen.value(other.image.transpose(1, 2, 0))
    agreed = seen.where & (parallax(view, seen, other) >= PARALLAX_PX)
    agreed &= disagreement(view, seen, other, other_depth) < AGREEMENT_PX
    agreed &= np.abs(colour - view.image.transpose(1, 2, 0)).mean(axis=2) < SAME_COLOUR
    warped = colour.mean(axis=2, dtype=np.float64)
    compared = seen.where & view.kept
    return agreed & (correlations(view.grey, warped[None], compared[None], plane_means)[0] > GOOD_MATCH)
