"""Photographs that are one picture under poses that differ: equal to the bit, or but for their encoding."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.depth_range import DepthRange
from ..cameras.overlap import inverse_depth_steps
from ..cameras.view_checks import Notice
from ..errors import ContradictionError
from ..photographs.images import FittedView
from .coarse_views import pixel_grid

PLAIN = 0.05  # of white; pictures whose values differ by less show nothing that could tell them apart
# One photograph as JPEG of quality 95 and of 90 differs by 1.2 to 2.7 of 255 on seven scenes, neighbouring views of
# these by 10.9 to 66, which is 1.4 times and more of what the least motion makes of one of them.
NEARLY = 3 / 255  # mean difference of the channels
OF_MOTION = 0.5  # of what the least motion that the poses allow makes of a photograph
STEP = 2  # px by which a photograph is moved to see what motion makes of it; less makes about as much less
MOVED = 1.0  # px at least; less is next to nothing
ANY_FAR = 1000.0  # times an estimated far: things may be farther than that
_GRID = 8  # places of a picture, each way
_DEPTHS = 32


def twins(views: Sequence[FittedView], depths: DepthRange, numbers: Sequence[int], trust_poses: bool) -> list[Notice]:
    """Those that are equal to the bit, and not of one colour, are refused: their poses are not, or the cameras were.

    A warning, as with `trust_poses`, are those that differ by less than NEARLY and by less than OF_MOTION of what a
    motion makes of them that is the least from near to far: another encoding of one file. Where the range is estimated
    it has no end, so that frames of a clip that hardly moved are none.
    """
    notices: list[Notice] = []
    for (i, one), (j, other) in combinations(zip(numbers, views, strict=True), 2):
        shown = one.image if one.mask is None else one.image[:, one.mask]
        if np.ptp(shown) < PLAIN:
            continue
        cure = "was one of them sent twice? send each photograph with the pose of its own"
        if np.array_equal(one.image, other.image):
            message = f"photographs {i} and {j} are the same picture, under poses that differ"
            if not trust_poses:
                raise ContradictionError(message, field="images", index=j, cure=cure)
        else:
            difference, moved = _difference(one, other), least_motion_px(one.camera, other.camera, depths)
            least = OF_MOTION * min(moved / STEP, 1.0) * _made_by_motion(one)
            if moved < MOVED or difference >= min(NEARLY, least):
                continue
            message = (
                f"photographs {i} and {j} differ by {255 * difference:.2g} of 255 on average, under poses that move "
                f"what they show by {moved:.2g} px at least"
            )
        notices.append({"code": "photos_equal", "field": "images", "index": j, "message": f"{message} ({cure})"})
    return notices


def least_motion_px(one: Camera, other: Camera, depths: DepthRange) -> float:
    """How far half of the picture moves or more if all of it lies at the depth at which that is the least."""
    far = depths.far if depths.source == "given" else ANY_FAR * depths.far
    places = pixel_grid((_GRID, _GRID)) * (one.width / _GRID, one.height / _GRID)
    least = np.inf
    for depth in inverse_depth_steps(depths.near, far, _DEPTHS):
        there, z = other.project(one.unproject(places, np.full(len(places), depth)))
        moved = np.where(z > 0, np.hypot(*(there - places).T), np.inf)
        least = min(least, float(np.median(moved)))
    return least


def _difference(one: FittedView, other: FittedView) -> float:
    """Mean of the channels over what both masks keep; infinite where that is nothing."""
    return _mean(np.abs(one.image - other.image), one.kept & other.kept)


def _made_by_motion(view: FittedView) -> float:
    """Mean difference of a photograph and itself STEP px on, in the direction of four that makes the least of it."""
    image, kept, height, width = view.image, view.kept, *view.image.shape[1:]
    least = np.inf
    for down, right in ((0, STEP), (STEP, 0), (STEP, STEP), (STEP, -STEP)):
        here = np.s_[: height - down, max(0, -right) : width - max(0, right)]
        there = np.s_[down:, max(0, right) : width - max(0, -right)]
        changed = np.abs(image[:, *here] - image[:, *there])
        least = min(least, _mean(changed, kept[here] & kept[there]))
    return least


def _mean(values: NDArray[np.float32], kept: NDArray[np.bool_]) -> float:
    return float(values[:, kept].mean(dtype=np.float64)) if kept.any() else np.inf
