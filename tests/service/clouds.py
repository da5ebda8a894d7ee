"""Random Gaussians in front of a camera: of all sizes and depths, some faint, some out of view."""

from __future__ import annotations

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians


def view(turn: float = 0.0, size: int = 40) -> Camera:
    pose = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[0, 3] = -2 * turn
    return Camera.make(size, size - 8, 45.0, 45.0, size / 2, size / 2 - 4, pose)


def cloud(count: int, seed: int, degree: int = 0, faint: float = 0.5) -> Gaussians:
    """Log-uniform sizes and depths; a share `faint` has small opacities, some lie out of sight."""
    rng = np.random.default_rng(seed)
    z = np.exp(rng.uniform(0, 1.8, count))
    means = np.column_stack([*(rng.uniform(-0.8, 0.8, (2, count)) * z), z])
    opacities = np.where(rng.random(count) < faint, 10 ** rng.uniform(-2.4, -0.5, count), rng.uniform(0.1, 1, count))
    harmonics = rng.normal(0, 0.15, (count, (degree + 1) ** 2, 3))
    harmonics[:, 0] = rng.uniform(-1.8, 2.5, (count, 3))
    scales = np.exp(rng.uniform(np.log(0.005), np.log(0.2), (count, 3)))
    return Gaussians.make(means, scales, rng.standard_normal((count, 4)), opacities, harmonics)
