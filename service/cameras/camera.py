"""The pinhole camera: intrinsics in pixels, a float64 camera-to-world pose in OpenCV axes, and the geometry of both.

Pixel i covers [i, i+1), so its centre is i + 0.5. Camera axes: x right, y down, z forward. Depth is z-depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arguments import real_number, shown
from ..errors import CameraError, IntrinsicsError
from .pose import AS_IT_IS, Given, Pose, checked_pose, rigid_inverse
from .rotations import rotated

F64 = NDArray[np.float64]

MAX_SIDE = 2**31 - 1  # px, more than any file format holds
LEAST_FOCAL, MOST_FOCAL = 0.1, 20  # focal lengths, of the side of the picture


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
    given: Given = AS_IT_IS  # how the pose was given

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
        """Check and build; `world_from_cam` is a matrix, or a `Pose` that was checked already.

        Raises `CameraError`, `IntrinsicsError` or `PoseError` naming field, index and numbers.
        """
        across, down = checked_side(width, "width", field, index), checked_side(height, "height", field, index)
        numbers = {}
        for name, given in (("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)):
            number = real_number(given)
            if number is None or not math.isfinite(number):
                told = shown(given) if number is None else f"{number}"
                raise IntrinsicsError(f"{name} = {told}, need a finite number", field=f"{field}.{name}", index=index)
            numbers[name] = number
        _check_focal(numbers["fx"], across, "fx", field, index)
        _check_focal(numbers["fy"], down, "fy", field, index)
        for name, size in (("cx", across), ("cy", down)):
            value = numbers[name]
            if not -size <= value <= 2 * size:
                raise IntrinsicsError(
                    f"{name} = {value:g} px lies far outside an image of {size:g} px",
                    field=f"{field}.{name}",
                    index=index,
                    cure="the principal point is in pixels from the upper left corner"
                    + ("; if it is that of a larger picture, scale fx, fy, cx and cy" if value > 0 else ""),
                )
        if not isinstance(world_from_cam, Pose):
            world_from_cam = checked_pose(world_from_cam, field=f"{field}.c2w", index=index)
        return cls(across, down, **numbers, world_from_cam=world_from_cam.matrix, given=world_from_cam.given)

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

    def resized(self, width: float, height: float) -> Camera:
        """The same view sampled on a grid of another size: intrinsics scale with it, rays do not move. Raises
        `CameraError` for other sides than `make` takes."""
        width, height = _checked_sides(width, height)
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

    def cropped(self, left: float, top: float, width: float, height: float) -> Camera:
        """The window of `width` x `height` px whose upper left corner lies at (left, top). Raises `CameraError` for
        other sides than `make` takes."""
        width, height = _checked_sides(width, height)
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def posed(self, world_from_cam: F64) -> Camera:
        """The same intrinsics at another pose."""
        return replace(self, world_from_cam=world_from_cam, given=AS_IT_IS)

    def rays(self, pixels: F64) -> F64:
        """World directions (N, 3) of pixel positions (N, 2); length such that the camera-frame z is 1."""
        cam = np.stack(
            [(pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy, np.ones(len(pixels))], axis=1
        )
        return rotated(self.rotation, cam)

    def unproject(self, pixels: F64, depth: F64) -> F64:
        """World points (N, 3) at z-depth `depth` (N,) behind pixel positions (N, 2)."""
        return self.center + self.rays(pixels) * np.asarray(depth)[:, None]

    def project(self, points: F64) -> tuple[F64, F64]:
        """Pixel positions (N, 2) and z-depths (N,) of world points (N, 3); pixels are NaN where z <= 0."""
        cam = rotated(self.rotation.T, np.asarray(points, dtype=np.float64) - self.center)
        z = cam[:, 2]
        safe = np.where(z > 0, z, np.nan)
        with np.errstate(over="ignore"):  # at z next to 0 the position overflows to infinity: outside any picture
            pixels = np.stack([self.fx * cam[:, 0] / safe + self.cx, self.fy * cam[:, 1] / safe + self.cy], axis=1)
        return pixels, z

    def shows(self, pixels: F64, z: F64) -> NDArray[np.bool_]:
        """(N,) whether the positions `pixels` (N, 2) with z-depths `z` (N,), as of `project`, lie in the picture."""
        inside = (pixels >= 0) & (pixels < (self.width, self.height))  # NaN behind the camera compares as False
        return inside.all(axis=1) & (z > 0)


def pixel_grid(shape: tuple[int, ...]) -> F64:
    """(h * w, 2) pixel centres (x, y) of a picture of `shape` (h, w), row by row."""
    rows, columns = shape
    return np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1).reshape(-1, 2)


def checked_side(value: float, name: str, field: str, index: int | None) -> int:
    """A side in px as `int`, also of a float without a fraction. Raises `CameraError` for anything else."""
    number = real_number(value)
    if number is None or not 1 <= number <= MAX_SIDE or not number.is_integer():
        told = shown(value) if number is None else f"{number:.12g}"
        message = f"{name} = {told}, need whole numbers from 1 to {MAX_SIDE}"
        raise CameraError(message, field=f"{field}.{name}", index=index, cure="give the size of the photograph in px")
    return int(number)


def _checked_sides(width: float, height: float) -> tuple[int, int]:
    return checked_side(width, "width", "camera", None), checked_side(height, "height", "camera", None)


def _check_focal(value: float, size: float, name: str, field: str, index: int | None) -> None:
    """Field of view between about 3 and 157 degrees: outside it the unit is wrong, not the lens."""
    ratio = value / size
    if LEAST_FOCAL <= ratio <= MOST_FOCAL:
        return
    cure = "give it in px of a picture of this very size: it grows with the picture"
    if value <= 0:
        cure = "focal lengths are positive; a negative one means flipped axes"
    elif LEAST_FOCAL <= value <= MOST_FOCAL:
        cure = f"these look normalised; multiply {name} by the image size, which would be {value * size:.4g} px"
    least, most = LEAST_FOCAL * size, MOST_FOCAL * size
    raise IntrinsicsError(
        f"{name} = {value:g} px for an image of {size:g} px, need between {least:g} and {most:g} px",
        field=f"{field}.{name}",
        index=index,
        cure=cure,
    )
