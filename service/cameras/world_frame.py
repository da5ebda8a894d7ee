"""From the caller's world to the network's frame and back: camera 0 at the origin, the near depth as the unit.

Both ways run in float64, so that an origin a million units away costs no digits of the scene, and units cost none at
all: the network always sees near = 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from ..harmonics import rotate_harmonics
from .camera import Camera
from .depth_range import DepthRange
from .pose import rigid_motion
from .rotations import quaternion_from_matrix, quaternion_product, rotated

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WorldFrame:
    """The rigid motion and scale that lead from the network's frame to the caller's world."""

    rotation: F64  # (3, 3) world from frame: that of camera 0
    origin: F64  # (3,) centre of camera 0, caller's units
    unit: float  # caller's units in one of the network's

    @classmethod
    def of(cls, cameras: Sequence[Camera], depths: DepthRange) -> WorldFrame:
        return cls(cameras[0].rotation, cameras[0].center, depths.near)

    def poses(self, cameras: Sequence[Camera]) -> NDArray[np.float32]:
        """(V, 4, 4) camera-to-frame poses; the origin is subtracted in float64 before anything is multiplied."""
        poses = [rigid_motion(self.rotation.T @ camera.rotation, self._center(camera)) for camera in cameras]
        return np.stack(poses).astype(np.float32)

    def _center(self, camera: Camera) -> F64:
        """(3,) the camera's centre in this frame."""
        return self.rotation.T @ (camera.center - self.origin) / self.unit

    def near_far(self, depths: DepthRange) -> NDArray[np.float32]:
        """(2,) the depth range in this frame's unit."""
        return np.array([depths.near / self.unit, depths.far / self.unit], dtype=np.float32)

    def depths(self, outputs: Mapping[str, NDArray]) -> F64:
        """(V, H, W) the network's z-depths in the caller's units."""
        return self.unit * outputs["depth"].astype(np.float64)

    def at_depths(self, outputs: Mapping[str, NDArray], cameras: Sequence[Camera], depths: F64) -> dict[str, NDArray]:
        """The outputs with each pixel's Gaussian moved along its ray to `depths` (V, H, W), z-depths in the caller's
        units, and its scales multiplied by the same ratio, so that its footprint in the view stays. Gaussians whose
        depth does not change keep their bits."""
        before = self.depths(outputs)
        ratio = (depths / before).reshape(len(cameras), -1, 1)
        count = before.size
        centers = np.stack([self._center(camera) for camera in cameras])[:, None]
        means = outputs["means"][:count].astype(np.float64).reshape(len(cameras), -1, 3)
        means = np.where(ratio == 1, means, centers + ratio * (means - centers))
        scales = ratio.reshape(-1, 1) * outputs["scales"][:count]
        return {
            **outputs,
            "means": np.concatenate([means.reshape(-1, 3).astype(np.float32), outputs["means"][count:]]),
            "scales": np.concatenate([scales.astype(np.float32), outputs["scales"][count:]]),
            "depth": (depths / self.unit).astype(np.float32),
        }

    def to_world(self, outputs: Mapping[str, NDArray], rows: NDArray[np.intp]) -> Gaussians:
        """The Gaussians in `rows` of the network's outputs, transformed into the caller's world."""
        means = self.origin + rotated(self.rotation, outputs["means"][rows]) * self.unit
        rotations = quaternion_product(quaternion_from_matrix(self.rotation), outputs["rotations_wxyz"][rows])
        return Gaussians.make(
            means=means,
            scales=outputs["scales"][rows].astype(np.float64) * self.unit,
            rotations_wxyz=rotations,
            opacities=outputs["opacities"][rows],
            harmonics=rotate_harmonics(outputs["harmonics"][rows], self.rotation),
        )
