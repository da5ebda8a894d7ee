"""Alternative readings of a set of poses, one per usual mistake of convention, each with its cure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .camera_fields import OPENCV_FROM_OPENGL
from .pose import rigid_inverse
from .pose_cures import convention, in_order, other_convention

# To x right, y down, z forward, from the axes of a robot: x forward, and y left, z up, or y right, z down.
OPENCV_FROM_LEFT_UP = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
OPENCV_FROM_RIGHT_DOWN = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
CLEARLY = 10.0  # times the baseline as read; below it the inverted poses would hardly have a baseline either
_LEFT_UP = "a robot's axes (x forward, y left, z up)"
_RIGHT_DOWN = "a robot's axes (x forward, y right, z down)"


@dataclass(frozen=True)
class Reading:
    """The cameras under another convention or order."""

    looks_like: str  # finishes the sentence "these poses look like ..."
    cure: str
    cameras: tuple[Camera, ...]
    order: bool = False  # a permutation of the same cameras, one of many


def other_readings(cameras: Sequence[Camera]) -> tuple[Reading, ...]:
    """Inverse poses, OpenGL instead of OpenCV axes (or the reverse), and both at once; with the cures of the file that
    they come from. These are all: turning the axes of the world as well changes no pose relative to another."""
    poses, given = [camera.world_from_cam for camera in cameras], convention(cameras)
    turned = "opencv" if given.axes == "opengl" else "opengl"
    readings = (
        (True, "opencv", [rigid_inverse(pose) for pose in poses]),
        (False, turned, [pose @ OPENCV_FROM_OPENGL for pose in poses]),
        (True, "opengl", [rigid_inverse(pose) @ OPENCV_FROM_OPENGL for pose in poses]),
    )
    told = (other_convention(given, inverted=inverted, axes=axes) for inverted, axes, _ in readings)
    return tuple(_posed(cameras, *words, moved) for words, (_, _, moved) in zip(told, readings, strict=True))


def robot_readings(cameras: Sequence[Camera]) -> tuple[Reading, ...]:
    """The axes of a robot's body, with the cures of the file that the poses come from."""
    poses, given = [camera.world_from_cam for camera in cameras], convention(cameras)
    opencv = given.axes == "opencv"
    readings = (
        (_LEFT_UP if opencv else _RIGHT_DOWN, ("-1", "-2", "0") if opencv else ("1", "-2", "-0"), OPENCV_FROM_LEFT_UP),
        (_RIGHT_DOWN if opencv else _LEFT_UP, ("1", "2", "0") if opencv else ("-1", "2", "-0"), OPENCV_FROM_RIGHT_DOWN),
    )
    return tuple(
        _posed(cameras, looks_like, in_order(given, lines), [pose @ axes for pose in poses])
        for looks_like, lines, axes in readings
    )


def _posed(cameras: Sequence[Camera], looks_like: str, cure: str, poses: Sequence[NDArray[np.float64]]) -> Reading:
    """The reading under which the cameras have these poses."""
    return Reading(looks_like, cure, tuple(c.posed(pose) for c, pose in zip(cameras, poses, strict=True)))


def with_cures(readings: Iterable[Reading]) -> str:
    """Each of them with its cure, to finish the sentence "these poses look like ..."."""
    return "; or ".join(f"{reading.looks_like}: {reading.cure}" for reading in readings)


def turned_photographs(cameras: Sequence[Camera], numbers: Sequence[int]) -> Reading:
    """The same cameras, where the photographs of these views are turned as EXIF says."""
    which = ", ".join(map(str, numbers))
    cure = f"save {'photograph' if len(numbers) == 1 else 'photographs'} {which} turned so, without the tag"
    return Reading("cameras of photographs that are turned as EXIF says", cure, tuple(cameras))


def other_orders(cameras: Sequence[Camera], numbers: Sequence[int]) -> Iterator[Reading]:
    """The cameras assigned to other photographs: every swap of two, and for three views both cyclic permutations.
    `numbers` are what the caller calls the views."""
    count = len(cameras)
    if count == 2:
        swapped = tuple(reversed(cameras))
        yield Reading("the cameras of the other photograph", "swap the two cameras or images", swapped)
        return
    swaps = [[j if k == i else i if k == j else k for k in range(count)] for i, j in combinations(range(count), 2)]
    cycles = [[1, 2, 0], [2, 0, 1]] if count == 3 else []
    for order in swaps + cycles:
        moved = [f"{numbers[k]} fits that of {numbers[own]}" for k, own in enumerate(order) if k != own]
        cure = f"send each photograph with its own camera, photograph {', '.join(moved)}"
        yield Reading("the cameras of other photographs", cure, tuple(cameras[own] for own in order), order=True)


def apart_when_inverted(cameras: Sequence[Camera]) -> str:
    """The end of a cure for cameras that all stand in one place, as world-to-camera matrices of a ring around the
    origin do when they are read as camera-to-world. Empty unless inverting the poses moves them CLEARLY apart.
    """
    centers = np.stack([rigid_inverse(camera.world_from_cam)[:3, 3] for camera in cameras])
    apart = _largest_distance(centers)
    as_read = _largest_distance(np.stack([camera.center for camera in cameras]))
    if apart <= max(CLEARLY * as_read, 1e-6 * float(np.abs(centers).max())):
        return ""
    given = convention(cameras)
    looks_like, cure = other_convention(given, inverted=True, axes=given.axes)
    return f"; if these are {looks_like}, {cure}: the cameras then stand {apart:.4g} apart"


def _largest_distance(centers: NDArray[np.float64]) -> float:
    """Between two of the points (V, 3)."""
    return max(float(np.linalg.norm(one - other)) for one in centers for other in centers)
