"""A normalised frame of a scene: upright, with its pivot at the origin and the pivot's depth as the unit.

Viewers orbit about a fixed vertical and have fixed clipping planes; in this frame both fit every scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.pose import rigid_motion
from ..cameras.rotations import quaternion_from_matrix, quaternion_product, rotated
from ..gaussians import Gaussians
from ..harmonics import rotate_harmonics
from .views import mean_camera, vertical

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LevelFrame:
    """The frame in the caller's world: x right, y down, z ahead of the cameras, level with their mean up direction."""

    rotation: F64  # (3, 3) world from frame
    origin: F64  # (3,) the pivot, caller's units
    unit: float  # caller's units in one of the frame

    @classmethod
    def of(cls, cameras: Sequence[Camera], pivot_depth: float) -> LevelFrame:
        """The frame of cameras with a pivot at z-depth `pivot_depth` (caller's units) of their mean."""
        middle, up = mean_camera(cameras, pivot_depth), vertical(cameras)
        ahead = middle.rotation[:, 2]
        right = np.cross(ahead, up)
        if np.linalg.norm(right) < 1e-6:  # looks along the vertical
            right = middle.rotation[:, 0]
        right = right / np.linalg.norm(right)
        level = np.stack([right, -up, np.cross(right, -up)], axis=1)
        return cls(level, middle.center + pivot_depth * ahead, pivot_depth)

    def gaussians(self, gaussians: Gaussians) -> Gaussians:
        """Transform Gaussians from the caller's world into this frame."""
        back = self.rotation.T
        return Gaussians.make(
            means=rotated(back, gaussians.means - self.origin) / self.unit,
            scales=gaussians.scales.astype(np.float64) / self.unit,
            rotations_wxyz=quaternion_product(
                quaternion_from_matrix(back), gaussians.rotations_wxyz.astype(np.float64)
            ),
            opacities=gaussians.opacities,
            harmonics=rotate_harmonics(gaussians.harmonics, back),
        )

    def camera(self, camera: Camera) -> Camera:
        """Transform a camera from the caller's world into this frame."""
        back = self.rotation.T
        pose = rigid_motion(back @ camera.rotation, back @ (camera.center - self.origin) / self.unit)
        return replace(camera, world_from_cam=pose)
