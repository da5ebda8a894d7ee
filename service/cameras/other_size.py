"""Intrinsics that look like those of pictures of another size, as after scaling photographs alone: warning and cure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import CameraError
from .camera import Camera

# A real lens has its principal point within some per cent of the middle: of six captures five have it at 1.00 to 1.04
# of the middle, one of cropped stereo pairs at 0.84 to 0.93 across, but at 1.02 down.
LEAST = 1.2  # times the middle, or the inverse of it
SAME = 1.1  # between the largest and the smallest of these factors, of both axes of all views


def other_size(cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    """The warning where all principal points stand at one multiple of the middle, both across and down, else none."""
    factors = np.array([[2.0 * camera.cx / camera.width, 2.0 * camera.cy / camera.height] for camera in cameras])
    if factors.min() <= 0 or factors.max() > SAME * factors.min():
        return []
    factor = float(np.exp(np.log(factors).mean()))
    if 1 / LEAST < factor < LEAST:
        return []
    first = cameras[0]
    width, height = (round(factor * side) for side in (first.width, first.height))
    corner = "that begin at the upper left corner" if factor > 1 else "that end at the lower right corner"
    message = (
        f"cx, cy = {first.cx:g}, {first.cy:g} px in a picture of {first.width} x {first.height} px, and the like in "
        f"every view: these look like the intrinsics of pictures of about {width} x {height} px (if so, multiply fx, "
        f"fy, cx and cy by the width of these pictures over the width of those; of crops {corner} they are right)"
    )
    return [{"code": "intrinsics_of_another_size", "field": "cameras.cx", "message": message}]


def told_first(cameras: Sequence[Camera], error: CameraError) -> None:
    """Put what `other_size` finds before the cure of a refusal that blames the poses: they may not be to blame."""
    for notice in other_size(cameras):
        error.cure = f"{notice['message']}; else: {error.cure}"
