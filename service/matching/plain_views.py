"""Photographs that show next to nothing (a covered lens, a blown-out sky, one wall), which no other can match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from .coarse_views import CoarseView
from .window_match import contrast

# Mean standard deviation of grey in the windows of a coarse view. 46 photographs of six captures have 0.084 and more,
# in an eighth of the light still 0.01; of several that are all so dark none is plain.
PLAIN = 1 / 255
OF_OTHERS = 0.1  # of the most that another view has


def plain_views(views: Sequence[CoarseView]) -> NDArray[np.bool_]:
    """(V,) whether a view has a mean contrast below PLAIN, and below OF_OTHERS of the one that has the most."""
    values = _contrasts(views)
    return (values < PLAIN) & (values < OF_OTHERS * values.max())


def plain_notices(views: Sequence[CoarseView], numbers: Sequence[int]) -> list[Notice]:
    """A warning about each plain view; `numbers` are what the caller calls the views."""
    values = _contrasts(views)
    notices: list[Notice] = []
    for place, (number, plain) in enumerate(zip(numbers, plain_views(views), strict=True)):
        if not plain:
            continue
        message = (
            f"photograph {number} shows next to nothing: where it is kept, its contrast is "
            f"{255 * values[place]:.2g} of 255 on average, and up to {255 * values.max():.2g} in the others, so that "
            "neither its pose can be checked nor depth be found in it"
        )
        cure = "was the lens covered, or the exposure wrong? leave it out"
        notices.append({"code": "photo_plain", "field": "images", "index": number, "message": f"{message} ({cure})"})
    return notices


def _contrasts(views: Sequence[CoarseView]) -> NDArray[np.float64]:
    return np.array([contrast(view.grey, view.kept)[view.kept].sum() / max(1, view.kept.sum()) for view in views])
