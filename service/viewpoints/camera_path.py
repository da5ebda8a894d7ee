"""Camera paths for films: a swing about the scene, a full orbit, or through the inputs and back.

A path is a closed loop: a function of time with period 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from ..cameras.camera import Camera
from ..errors import ViewError
from .input_path import InputPath
from .level_frame import LevelFrame
from .views import orbit_camera

PathName = Literal["turntable", "inputs", "orbit"]
PATHS: tuple[PathName, ...] = get_args(PathName)

LEAST_SWING, MOST_SWING = 5.0, 90.0  # degrees: less is hardly visible, more shows what no input sees

Path = Callable[[float], Camera]


def camera_path(name: PathName, cameras: Sequence[Camera], *, pivot_depth: float, swing: float | None = None) -> Path:
    """The path of this name, from the time in [0, 1] to the camera at that moment.

    "turntable" swings about the pivot at z-depth `pivot_depth` (caller's units) of the mean camera, to its right, to
    its left and back, by `swing` degrees each way (default: `seen_swing`); "orbit" goes round it once, also where no
    input has seen anything; "inputs" goes through the cameras in their order and back. Raises `ViewError`.
    """
    if name not in PATHS:
        raise ViewError(f"{name[:50]!r} is no path", field="path", cure=f"one of {', '.join(PATHS)}")
    if swing is not None and name != "turntable":
        raise ViewError(f"goes with the path turntable, not with {name}", field="swing", cure="leave it out")
    if swing is not None and not 0 < swing <= 180:
        raise ViewError(f"is {swing:g} degrees, need more than 0 and at most 180", field="swing")
    if name == "inputs":
        return InputPath.through(cameras, pivot_depth).at
    if name == "orbit":
        return lambda time: orbit_camera(cameras, math.tau * (time % 1.0), pivot_depth)
    most = math.radians(seen_swing(cameras, pivot_depth) if swing is None else swing)
    return lambda time: orbit_camera(cameras, most * math.sin(math.tau * (time % 1.0)), pivot_depth)


def loop(path: Path, frames: int) -> list[Camera]:
    """`frames` cameras at equal time steps of one period; the first is not repeated at the end."""
    return [path(index / frames) for index in range(frames)]


def seen_swing(cameras: Sequence[Camera], pivot_depth: float) -> float:
    """Degrees each way within which a swing stays among the inputs: the largest azimuth, seen from the pivot, between
    the mean camera and an input, clipped to `LEAST_SWING` and `MOST_SWING`. Beyond the inputs nothing was seen.
    """
    frame = LevelFrame.of(cameras, pivot_depth)
    right, _, ahead = np.stack([frame.camera(camera).center for camera in cameras]).T
    angles = np.degrees(np.arctan2(right, -ahead))
    return float(np.clip(np.abs(angles).max(), LEAST_SWING, MOST_SWING))
