"""Duplicate photographs under different poses: equal to the bit, or up to their encoding."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera, pixel_grid
from ..cameras.depth_range import DepthRange
from ..cameras.overlap import inverse_depth_steps
from ..cameras.view_checks import Notice
from ..errors import ContradictionError
from ..photographs.images import FittedView

PLAIN = 0.05  # of white: least range of values; a plain picture has nothing to tell it from another
# One photograph as JPEG of quality 95 and of 90 differs by 1.2 to 2.7 of 255 on seven scenes, neighbouring views of
# these by 10.9 to 66, which is 1.4 times and more of what the least motion makes of one of them.
NEARLY = 3 / 255  # mean difference of the channels
OF_MOTION = 0.5  # of the difference that the least motion under the poses would make
STEP = 2  # px by which a photograph is shifted to measure the effect of motion, which is about linear below
MOVED = 1.0  # px: least motion that can be told from none
ANY_FAR = 1000.0  # times an estimated far: things may be farther than that
_GRID = 8  # places of a picture, each way
_DEPTHS = 32


def duplicates(
    views: Sequence[FittedView], depths: DepthRange, numbers: Sequence[int], trust_poses: bool
) -> list[Notice]:
    """Warnings about duplicates. Raises `ContradictionError` for photographs that are equal to the bit and not plain,
    unless `trust_poses`; cameras of equal poses were refused before.

    Also a duplicate, but only warned of, is a photograph in another encoding: one that differs by less than NEARLY, and
    by less than OF_MOTION of the difference that the least motion over the depth range would make. An estimated range
    is extended to ANY_FAR times far, so that frames of a clip that hardly moved are not taken for duplicates. `numbers`
    are what the caller calls the views.
    """
    notices: list[Notice] = []
    for (i, one), (j, other) in combinations(zip(numbers, views, strict=True), 2):
        if np.ptp(one.image[:, one.kept]) < PLAIN:
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
    """The median displacement in px over a grid of pixels, at the depth of the range where it is least."""
    far = depths.far if depths.source == "given" else ANY_FAR * depths.far
    places = pixel_grid((_GRID, _GRID)) * (one.width / _GRID, one.height / _GRID)
    least = np.inf
    for depth in inverse_depth_steps(depths.near, far, _DEPTHS):
        there, z = other.project(one.unproject(places, np.full(len(places), depth)))
        moved = np.where(z > 0, np.hypot(*(there - places).T), np.inf)
        least = min(least, float(np.median(moved)))
    return least


def _difference(one: FittedView, other: FittedView) -> float:
    """Mean absolute difference over the pixels that both masks keep; infinite where there are none."""
    return _mean(np.abs(one.image - other.image), one.kept & other.kept)


def _made_by_motion(view: FittedView) -> float:
    """Mean absolute difference of a photograph from itself shifted by STEP px, the least over four directions."""
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
