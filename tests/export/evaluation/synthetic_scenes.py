"""Analytic scenes for the evaluation's tests: a wall, optionally with a slab in front of it, seen by cameras side by
side."""

from __future__ import annotations

import numpy as np

from gapmes.export.evaluation.case import Case, TrueDepth
from gapmes.service.cameras.camera import Camera
from gapmes.service.photographs.images import FittedView, Photo

SIZE = 64  # px
NEAR, FAR = 1.0, 8.0


def camera_at(x: float, size: int = SIZE) -> Camera:
    """A camera at (x, 0, 0) that looks along +z."""
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera.make(size, size, 0.9 * size, 0.9 * size, size / 2, size / 2, pose)


def texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    """(3, ...) in [0, 1]: waves of a few wavelengths, none shorter than several pixels of the cameras here."""
    waves = [np.sin(a * x + b * y + c + phase) for a, b, c in ((5, 2, 0), (-3, 6, 1), (8, -4, 2), (2, 9, 4))]
    channels = [waves[0] + waves[1] * waves[2], waves[1] - waves[3], waves[2] * waves[3] + waves[0]]
    return np.stack([0.5 + 0.2 * channel for channel in channels]).clip(0, 1)


class StepScene:
    """A wall at z = `wall` + `slope` x, with a slab in front of it at z = `slab` over |x| < `half_width` (0: none)."""

    def __init__(self, wall: float, slope: float = 0.0, slab: float = 1.5, half_width: float = 0.0) -> None:
        self.wall, self.slope, self.slab, self.half_width = wall, slope, slab, half_width

    def depth(self, camera: Camera) -> np.ndarray:
        """(H, W) exact z-depth at the pixel centres."""
        rays, _ = self._rays(camera)
        depth = (self.wall + self.slope * camera.center[0]) / (1 - self.slope * rays[0])
        on_slab = np.abs(camera.center[0] + self.slab * rays[0]) < self.half_width
        return np.where(on_slab, self.slab, depth).astype(np.float32)

    def view(self, camera: Camera) -> FittedView:
        rays, _ = self._rays(camera)
        depth = self.depth(camera).astype(np.float64)
        phase = np.where(depth == self.slab, 2.0, 0.0) if self.half_width else 0.0
        image = texture(camera.center[0] + depth * rays[0], depth * rays[1], phase)
        return FittedView(image.astype(np.float32), None, camera, 1.0)

    def case(self, inputs: tuple[float, ...] = (-0.2, 0.2), targets: tuple[float, ...] = (0.0,)) -> Case:
        seen, held = [self.view(camera_at(x)) for x in inputs], [self.view(camera_at(x)) for x in targets]
        photos = [Photo.from_array(np.rint(v.image.transpose(1, 2, 0) * 255).astype(np.uint8)) for v in seen]
        return Case(
            name="step",
            photos=tuple(photos),
            cameras=tuple(view.camera for view in seen),
            inputs=tuple(seen),
            targets=tuple(held),
            near=NEAR,
            far=FAR,
            truth=TrueDepth(
                np.stack([self.depth(v.camera) for v in seen]), np.stack([self.depth(v.camera) for v in held]), FAR
            ),
        )

    def _rays(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        pixels = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
        rays = camera.rays(pixels.reshape(-1, 2)).T.reshape(3, camera.height, camera.width)
        return rays, pixels
