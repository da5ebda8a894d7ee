"""Analytic photographs of a textured plane: every pixel's colour is a smooth function of its world point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis

DEPTH = 4.0  # of the plane z = DEPTH in the world of the unmoved scene
WAVES = 24
# The axes of a robot, x forward, y left and z up, in those of its camera.
ROBOT = np.eye(4)[[1, 2, 0, 3]] * [[-1], [-1], [1], [1]]


@dataclass(frozen=True)
class PlaneScene:
    cameras: tuple[Camera, ...]
    images: tuple[np.ndarray, ...]  # uint8 (H, W, 3)
    near: float
    far: float

    @classmethod
    def make(
        cls, rng: np.random.Generator, count: int = 3, size: tuple[int, int] = (96, 72), turn: float = 1.0
    ) -> PlaneScene:
        """Cameras in an arc that look at the plane's middle; lenses differ in focal length and principal point.

        `turn` scales their rotations: with 0 all look along z.
        """
        width, height = size
        waves = rng.normal(size=(3, WAVES, 2)) * rng.choice([2.0, 7.0, 14.0], size=(3, WAVES, 1))
        phases = rng.uniform(0, 2 * np.pi, size=(3, WAVES))
        cameras, images = [], []
        for index in range(count):
            pose = np.eye(4)
            pose[:3, 3] = [0.6 * index - 0.5, 0.15 * index, 0.1 * index]
            pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), turn * (0.1 - 0.12 * index)) @ about_axis(
                np.array([1.0, 0.0, 0.0]), 0.03 * turn * index
            )
            camera = Camera.make(
                width, height, 90.0 + 3 * index, 88.0 + 2 * index, width / 2 + index, height / 2 - 2 * index, pose
            )
            cameras.append(camera)
            images.append(photograph(camera, waves, phases))
        return cls(tuple(cameras), tuple(images), 2.0, 8.0)

    def moved(self, rotation: np.ndarray, translation: np.ndarray, unit: float) -> PlaneScene:
        """The same photographs in another world: x -> unit * R x + t."""
        cameras = []
        for camera in self.cameras:
            pose = np.eye(4)
            pose[:3, :3] = rotation @ camera.rotation
            pose[:3, 3] = unit * (rotation @ camera.center) + translation
            cameras.append(camera.posed(pose))
        return PlaneScene(tuple(cameras), self.images, unit * self.near, unit * self.far)


def photograph(camera: Camera, waves: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """uint8 (H, W, 3) of the plane, sampled at pixel centres."""
    grid = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), -1).reshape(-1, 2)
    rays = camera.rays(grid)
    points = camera.center + rays * ((DEPTH - camera.center[2]) / rays[:, 2])[:, None]
    signal = np.cos(points[:, :2] @ waves.transpose(0, 2, 1) + phases[:, None]).sum(axis=2).T
    levels = np.rint(255 * (0.5 + signal / (2.2 * np.sqrt(WAVES)))).clip(0, 255)
    return levels.reshape(camera.height, camera.width, 3).astype(np.uint8)
