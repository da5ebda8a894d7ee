"""Cameras around, beside and apart from each other, and what must hold for a path among them in any world."""

from __future__ import annotations

import math

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.viewpoints.camera_path import PathName, camera_path, loop

PIVOT = 3.0
UP = np.array([0.0, 1.0, 0.0])


def camera(rotation: np.ndarray, center: object, focal: float = 60.0) -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, center
    return Camera.make(64, 48, focal, 62.0, 31.0, 24.0, pose)


def arc(degrees: float, count: int = 5) -> list[Camera]:
    """Cameras at distance `PIVOT` that look at the origin, evenly from -degrees to degrees about the vertical."""
    rotations = [about_axis(UP, -math.radians(a)) for a in np.linspace(-degrees, degrees, count)]
    return [camera(rotation, -PIVOT * rotation[:, 2]) for rotation in rotations]


def ring(count: int, tilt: float = 0.3) -> list[Camera]:
    """Cameras at distance `PIVOT` all around the origin, which they look down at by `tilt`."""
    turns = [about_axis(UP, a) @ about_axis(np.array([1.0, 0, 0]), -tilt) for a in math.tau * np.arange(count) / count]
    return [camera(rotation, -PIVOT * rotation[:, 2]) for rotation in turns]


def moves_with_the_world(cameras: list[Camera], scale: float, name: PathName) -> None:
    turn, offset = about_axis(np.array([0.0, 0.6, 0.8]), 1.0), np.array([100.0, -200.0, 7.0])

    def moved(one: Camera) -> Camera:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn @ one.rotation, scale * (turn @ one.center + offset)
        return one.posed(pose)

    plain = loop(camera_path(name, cameras, pivot_depth=PIVOT), 5)
    other = loop(camera_path(name, [moved(one) for one in cameras], pivot_depth=scale * PIVOT), 5)
    for one, found in zip(plain, other, strict=True):
        expected = moved(one)
        np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-7)
        np.testing.assert_allclose(found.center / scale, expected.center / scale, atol=1e-7)
