"""The pinhole camera: intrinsics in pixels, a float64 camera-to-world pose in OpenCV axes, and the geometry of both.

Pixel i covers [i, i+1), so its centre is i + 0.5. Camera axes: x right, y down, z forward. Depth is z-depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import CameraError, IntrinsicsError, PoseError

F64 = NDArray[np.float64]

# A rotation further than this from orthonormal moves a pixel by more than 0.1 px at f = 1000 px; below it the matrix
# is projected onto SO(3), which is what rounding to six decimals in a text file needs.
MAX_ORTHONORMALITY_ERROR = 1e-4
MAX_SIDE = 2**31 - 1  # px, more than any file format holds
MAX_OFFSET = 1e100  # caller's units: squares and cubes stay finite
ROUNDING = 1e-14  # what float64 leaves of orthonormality (some 1e-15); such a matrix is kept to the bit


@dataclass(frozen=True, eq=False)
class Camera:
    """A posed pinhole camera; build it with `Camera.make`, which checks everything once."""

    width: int  # px
    height: int  # px
    fx: float  # px
    fy: float  # px
    cx: float  # px
    cy: float  # px
    world_from_cam: F64  # (4, 4), rotation | centre, caller's units

    @classmethod
    def make(
        cls,
        width: float,
        height: float,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        world_from_cam: object,
        *,
        index: int | None = None,
        field: str = "camera",
    ) -> Camera:
        """Check and build. Raises `CameraError`, `IntrinsicsError` or `PoseError` naming field, index and numbers."""
        if not (_whole(width) and _whole(height)):
            raise CameraError(
                f"image size is {width} x {height}, need whole numbers from 1 to {MAX_SIDE}",
                field=f"{field}.size",
                index=index,
            )
        numbers = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
        for name, value in numbers.items():
            if not math.isfinite(value):
                raise IntrinsicsError(f"{name} = {value}, need a finite number", field=f"{field}.{name}", index=index)
        _check_focal(fx, width, "fx", field, index)
        _check_focal(fy, height, "fy", field, index)
        for name, value, size in (("cx", cx, width), ("cy", cy, height)):
            if not -size <= value <= 2 * size:
                raise IntrinsicsError(
                    f"{name} = {value:g} px lies far outside an image of {size:g} px",
                    field=f"{field}.{name}",
                    index=index,
                    cure="principal point is in pixels from the upper left corner",
                )
        pose = checked_pose(world_from_cam, field=f"{field}.c2w", index=index)
        return cls(int(width), int(height), float(fx), float(fy), float(cx), float(cy), pose)

    @property
    def rotation(self) -> F64:
        """(3, 3) camera-to-world rotation."""
        return self.world_from_cam[:3, :3]

    @property
    def center(self) -> F64:
        """(3,) camera centre in the world."""
        return self.world_from_cam[:3, 3]

    @property
    def cam_from_world(self) -> F64:
        """(4, 4) rigid inverse [R^T | -R^T t]."""
        return rigid_inverse(self.world_from_cam)

    @property
    def intrinsics(self) -> F64:
        """(3, 3) K in pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def normalized_intrinsics(self) -> F64:
        """(3, 3) K with the first row divided by the width and the second by the height (the network's unit)."""
        return self.intrinsics / np.array([[self.width], [self.height], [1.0]])

    def resized(self, width: int, height: int) -> Camera:
        """The same view sampled on a grid of another size: intrinsics scale with it, rays do not move."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )

    def cropped(self, left: float, top: float, width: int, height: int) -> Camera:
        """The window of `width` x `height` px whose upper left corner lies at (left, top)."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def posed(self, world_from_cam: F64) -> Camera:
        """The same lens at another pose."""
        return replace(self, world_from_cam=world_from_cam)

    def rays(self, pixels: F64) -> F64:
        """World directions (N, 3) of pixel positions (N, 2); length such that the camera-frame z is 1."""
        cam = np.stack(
            [(pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy, np.ones(len(pixels))], axis=1
        )
        return cam @ self.rotation.T

    def unproject(self, pixels: F64, depth: F64) -> F64:
        """World points (N, 3) at z-depth `depth` (N,) behind pixel positions (N, 2)."""
        return self.center + self.rays(pixels) * np.asarray(depth)[:, None]

    def project(self, points: F64) -> tuple[F64, F64]:
        """Pixel positions (N, 2) and z-depths (N,) of world points (N, 3); pixels are NaN where z <= 0."""
        cam = (np.asarray(points, dtype=np.float64) - self.center) @ self.rotation
        z = cam[:, 2]
        safe = np.where(z > 0, z, np.nan)
        with np.errstate(over="ignore"):  # next to the camera's own plane a point is infinitely far off the picture
            pixels = np.stack([self.fx * cam[:, 0] / safe + self.cx, self.fy * cam[:, 1] / safe + self.cy], axis=1)
        return pixels, z


def rigid_inverse(matrix: F64) -> F64:
    """(4, 4) inverse of a rigid motion, exact to rounding: [R^T | -R^T t]."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def checked_pose(value: object, *, field: str = "c2w", index: int | None = None) -> F64:
    """Parse a (4, 4) or (3, 4) rigid motion; a drift below 1e-4 is projected onto SO(3), more is refused.

    A rotation that is one to rounding stays as it is, so that a pose that was checked once is never changed again.
    """
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise PoseError(
            "is not a matrix of numbers", field=field, index=index, cure="give 4 rows of 4 numbers"
        ) from error
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise PoseError(f"shape is {matrix.shape}, need (4, 4)", field=field, index=index)
    bad = int((~np.isfinite(matrix)).sum())
    if bad:
        raise PoseError(f"{bad} of 16 numbers are NaN or infinite", field=field, index=index)
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise PoseError(
            f"last row is {matrix[3].tolist()}, need [0, 0, 0, 1]", field=field, index=index, cure="is it transposed?"
        )
    offset = float(np.abs(matrix[:3, 3]).max())
    if offset > MAX_OFFSET:
        raise PoseError(f"the camera is {offset:.3g} units away, need at most {MAX_OFFSET:g}", field=field, index=index)
    rotation = matrix[:3, :3]
    largest = float(np.abs(rotation).max())
    if largest > MAX_OFFSET:
        raise PoseError(f"R has an entry of {largest:.3g}, need at most 1", field=field, index=index)
    drift = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    det = float(rotation[0] @ np.cross(rotation[1], rotation[2]))  # np.linalg.det divides by pivots, which may be 0
    if det < 0:
        raise PoseError(
            f"det(R) = {det:.4g}, need +1",
            field=field,
            index=index,
            cure="one axis is mirrored; is the source left-handed?",
        )
    if drift > MAX_ORTHONORMALITY_ERROR:
        scale = abs(det) ** (1 / 3)
        uniform = scale > 0 and np.abs(rotation.T @ rotation / scale**2 - np.eye(3)).max() < 1e-3
        cure = f"R carries a scale of {scale:.6g}; divide it out" if uniform else "R is sheared or not a rotation"
        raise PoseError(
            f"max |R^T R - I| = {drift:.3g}, need at most {MAX_ORTHONORMALITY_ERROR:g} (det {det:.4g})",
            field=field,
            index=index,
            cure=cure,
        )
    if drift > ROUNDING:
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = matrix[:3, 3]
    return pose


def _whole(value: float) -> bool:
    try:
        return math.isfinite(value) and int(value) == value and 1 <= value <= MAX_SIDE
    except OverflowError:  # a Python integer beyond float64
        return False


def _check_focal(value: float, size: float, name: str, field: str, index: int | None) -> None:
    """Field of view between about 3 and 157 degrees: outside it the unit is wrong, not the lens."""
    ratio = value / size
    if 0.1 <= ratio <= 20:
        return
    cure = None
    if value <= 0:
        cure = "focal lengths are positive; a negative one means flipped axes"
    elif 0.1 <= value <= 20:
        cure = f"these look normalised; multiply {name} by the image size ({value * size:.4g} px)"
    raise IntrinsicsError(
        f"{name} = {value:g} px for an image of {size:g} px, need between {0.1 * size:g} and {20 * size:g} px",
        field=f"{field}.{name}",
        index=index,
        cure=cure,
    )
