"""Which photographs foretell another one, whose picture from a reconstruction of them tells what a new view is like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .camera import Camera
from .errors import InputError
from .view_checks import MAX_VIEWS, MIN_VIEWS

# Of three photographs both others; of more, two as well, so that each costs no more than a run with two views.
DEFAULT_OTHERS = 2


def checked_others(count: int) -> int:
    """Raises `InputError` unless it is 0 (nothing is foretold) or so many views can foretell another one."""
    if isinstance(count, bool) or not isinstance(count, int) or count not in (0, *range(MIN_VIEWS, MAX_VIEWS)):
        raise InputError(
            f"is {count}, need {MIN_VIEWS} to {MAX_VIEWS - 1} views that foretell another, or 0 for none",
            field="leave_one_out",
        )
    return count


def nearest_others(cameras: Sequence[Camera], index: int, count: int) -> list[int]:
    """The `count` cameras nearest to that of `index`, all the others where there are fewer, in their own order."""
    distances = [float(np.linalg.norm(camera.center - cameras[index].center)) for camera in cameras]
    others = sorted((distance, other) for other, distance in enumerate(distances) if other != index)
    return sorted(other for _, other in others[:count])
