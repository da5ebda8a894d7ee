"""Leave-one-out: from which other photographs each one is reconstructed, to tell how good a novel view is."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..arguments import shown, whole_number
from ..errors import InputError
from .camera import Camera
from .spanning_tree import DIGITS
from .view_checks import MAX_VIEWS, MIN_PARALLAX_PX, MIN_VIEWS, Notice, parallax_px

# Of three photographs both others; of more, two as well, so that each costs no more than a run with two views.
DEFAULT_OTHERS = 2


def checked_others(count: int) -> int:
    """As `int`. Raises `InputError` unless it is 0 (no leave-one-out) or a number of views that can be reconstructed
    from: MIN_VIEWS to MAX_VIEWS - 1."""
    others = whole_number(count)
    if others is None or others not in (0, *range(MIN_VIEWS, MAX_VIEWS)):
        raise InputError(
            f"is {shown(count)}, need {MIN_VIEWS} to {MAX_VIEWS - 1} views that foretell another, or 0 for none",
            field="leave_one_out",
        )
    return others


def nearest_others(cameras: Sequence[Camera], index: int, count: int, near: float) -> list[int]:
    """Indices of the `count` cameras nearest to camera `index`, ascending; of all the others where there are fewer.

    At least two of them have parallax at depth `near`: of the combinations in order of nearness the first that has is
    taken, and none where no two of the others have any. Ties in distance are broken by where the camera sees the other
    one: left before right, above before below, behind before ahead. The order of the photographs therefore decides
    nothing.
    """
    camera = cameras[index]
    others = [other for other in range(len(cameras)) if other != index]
    longest = max(float(np.linalg.norm(cameras[other].center - camera.center)) for other in others) or 1.0

    def nearness(other: int) -> list[float]:
        place = camera.rotation.T @ (cameras[other].center - camera.center) / longest
        turn = camera.rotation.T @ cameras[other].rotation  # of those in one place
        return [round(float(value), DIGITS) for value in (np.linalg.norm(place), *place, *turn.ravel())]

    others.sort(key=nearness)
    for chosen in combinations(others, min(count, len(others))):
        if _widest_px([cameras[other] for other in chosen], near) >= MIN_PARALLAX_PX:
            return sorted(chosen)
    return []


def not_foretold(cameras: Sequence[Camera], index: int, near: float, number: int) -> Notice:
    """The warning about a camera for which `nearest_others` has none; `number` is what the caller calls its view."""
    widest = _widest_px([*cameras[:index], *cameras[index + 1 :]], near)
    message = (
        f"view {number} is not foretold: the others stand in one place, the widest pair of them shifts a point at "
        f"near = {near:.4g} by {widest:.3g} px, need at least {MIN_PARALLAX_PX} (photographs from more places would "
        "foretell it)"
    )
    return {"code": "not_foretold", "field": "cameras", "index": number, "message": message}


def _widest_px(cameras: Sequence[Camera], near: float) -> float:
    return max(parallax_px(one, other, near) for one, other in combinations(cameras, 2))
