"""Cameras of views: an input view, an interpolation between two of them, or an orbit about the pivot."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..cameras.camera import Camera
from ..cameras.pose import rigid_motion
from ..cameras.rotations import CANCELLED, F64, about_axis, mean_rotation, slerp
from ..errors import ViewError
from .framing import frame

_LENS = ("fx", "fy", "cx", "cy")
_NUMBER = re.compile(r"[0-9]{1,9}(\.[0-9]{1,30})?")
_ORBIT = re.compile(r"orbit:([+-]?[0-9]{1,6}(?:\.[0-9]{1,30})?)")


def resolve_view(spec: str, cameras: Sequence[Camera], *, pivot_depth: float) -> Camera:
    """The camera that `spec` names.

    "2" is input view 2. "1.5" lies half way between views 1 and 2: slerp of the rotation, linear interpolation of
    centre and intrinsics, at the size of view 1, to which the other is cropped. "orbit:30" is the mean camera rotated
    by 30 degrees, to the right, about the vertical through its pivot, which is the point at z-depth `pivot_depth`
    (caller's units) on its optical axis. Raises `ViewError`.
    """
    text = spec.strip()
    orbit = _ORBIT.fullmatch(text)
    if orbit is not None:
        return orbit_camera(cameras, math.radians(float(orbit[1])), pivot_depth)
    if _NUMBER.fullmatch(text) is None:
        raise ViewError(
            f"{spec[:50]!r} is not a view",
            field="view",
            cure='give an index ("2"), a place between two views ("1.5") or an orbit in degrees ("orbit:30")',
        )
    place = float(text)
    if place > len(cameras) - 1:
        raise ViewError(
            f"{text} is out of range, there are {len(cameras)} views: 0 to {len(cameras) - 1}",
            field="view",
            cure="views are counted from 0",
        )
    first = int(place)
    if place == first:
        return cameras[first]
    return between(cameras[first], cameras[first + 1], place - first)


def between(start: Camera, end: Camera, fraction: float) -> Camera:
    """The camera interpolated at `fraction` from `start` to `end`, with the picture size of `start`."""
    end = frame(end, start.width, start.height)
    center = start.center + fraction * (end.center - start.center)
    pose = rigid_motion(slerp(start.rotation, end.rotation, fraction), center)
    lens = {name: (1 - fraction) * getattr(start, name) + fraction * getattr(end, name) for name in _LENS}
    return replace(start.posed(pose), **lens)


def mean_camera(cameras: Sequence[Camera], pivot_depth: float) -> Camera:
    """Mean rotation and mean intrinsics, with the picture size of the first camera, at the mean centre.

    Where the cameras converge, their mean centre lies between them and what they look at. The mean camera stands back
    from there, until its pivot at z-depth `pivot_depth` (caller's units) is the mean of their pivots. They converge if
    their pivots have a smaller variance than their centres.
    """
    first = cameras[0]
    rotation = mean_rotation(np.stack([camera.rotation for camera in cameras]))
    centers = np.stack([camera.center - first.center for camera in cameras])
    to_pivots = pivot_depth * np.stack([camera.rotation[:, 2] for camera in cameras])
    center = first.center + centers.mean(axis=0)
    if _variance(centers + to_pivots) < _variance(centers):
        center += to_pivots.mean(axis=0) - pivot_depth * rotation[:, 2]
    framed = [frame(camera, first.width, first.height) for camera in cameras]
    fx, fy, cx, cy = (float(np.mean([getattr(camera, name) for camera in framed])) for name in _LENS)
    return replace(first, world_from_cam=rigid_motion(rotation, center), fx=fx, fy=fy, cx=cx, cy=cy)


def orbit_camera(cameras: Sequence[Camera], angle: float, pivot_depth: float) -> Camera:
    """The mean camera rotated by `angle` radians about the vertical through its pivot.

    A positive angle moves the camera to its right, and it keeps looking at the pivot.
    """
    middle = mean_camera(cameras, pivot_depth)
    to_pivot = pivot_depth * middle.rotation[:, 2]
    turn = about_axis(vertical(cameras), angle)
    return middle.posed(rigid_motion(turn @ middle.rotation, middle.center + to_pivot - turn @ to_pivot))


def vertical(cameras: Sequence[Camera]) -> F64:
    """(3,) the mean up direction of the cameras as a unit vector in the world; up is -y in the camera.

    Where their up directions cancel, that of their mean rotation.
    """
    up = -np.mean([camera.rotation[:, 1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(up))
    if length > CANCELLED:
        return up / length
    return -mean_rotation(np.stack([camera.rotation for camera in cameras]))[:, 1]


def _variance(points: F64) -> float:
    """Mean squared distance of points (N, 3) from their mean."""
    return float(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
