"""Where another view sees a view's pixels, once they have a depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.rotations import turned
from ..photographs.bilinear import bilinear
from ..photographs.images import FittedView
from .coarse_views import pixel_grid
from .place_kernels import sample_places, see_pixels

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

PARALLAX_PX = 4.0  # from what is infinitely far: with less any depth seems right
LEAST_WAY = 0.05  # between two views, of the longest: another from nearly the same place tells nothing of depth
KEPT = 0.999  # of a value's weight, up to rounding: none of it is of a masked pixel


@dataclass(frozen=True, eq=False)
class Seen:
    """The pixels of one view (H, W) in the picture of another."""

    column: F64  # (H, W) index of a pixel there, real-valued
    row: F64
    z: F64  # (H, W) z-depth there; 1 where it is not seen
    inside: Mask  # (H, W) in front of the other view and inside its picture
    where: Mask  # (H, W) of these in full on what its mask keeps

    def value(self, picture: NDArray[np.floating]) -> NDArray[np.floating]:
        """(H, W, C) what `picture` (h, w, C) of the other view has at these places, in its own precision."""
        values = np.ascontiguousarray(picture)
        found = np.empty((*self.z.shape, picture.shape[2]), picture.dtype)
        sample_places(values, self.column, self.row, found)
        return found


def seen_by(view: FittedView, depth: F64, other: FittedView) -> Seen:
    """`depth` (H, W) are z-depths of the view's pixels in the cameras' units."""
    column, row, z = (np.empty(depth.shape) for _ in range(3))
    inside = np.empty(depth.shape, np.bool_)
    (lens, pose), (other_lens, other_pose) = _parts(view.camera), _parts(other.camera)
    size = np.array([other.camera.width, other.camera.height], np.float64)
    depth = np.ascontiguousarray(depth, np.float64)
    see_pixels(depth, lens, pose, other_lens, other_pose, size, column, row, z, inside.view(np.uint8))
    where = inside
    if other.mask is not None:
        where = inside & (bilinear(other.mask.astype(np.float32)[..., None], column, row)[..., 0] > KEPT)
    return Seen(column, row, np.where(where, z, 1.0), inside, where)


def _parts(camera: Camera) -> tuple[F64, F64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy]), np.ascontiguousarray(camera.world_from_cam[:3])


def disagreement(view: FittedView, seen: Seen, other: FittedView, other_depth: F64) -> F64:
    """(H, W) px of parallax between the depth that a pixel has for the other view and that view's own (H, W) there."""
    theirs = seen.value(other_depth[..., None])[..., 0]
    return np.abs(1 / seen.z - 1 / theirs) * pixels_per_inverse_depth(view, other)


def parallax(view: FittedView, seen: Seen, other: FittedView) -> F64:
    """(H, W) px in the other view from where a pixel would be seen that is infinitely far to where it is seen.

    None along the way from one view to the other, however long it is; infinite where the other view would have what is
    infinitely far behind it. With t the centre of the view and r the pixel's ray, both in the axes of the other view,
    (t + d r) / z - r / r_z is (t r_z - r t_z) / (r_z z), where z is (t + d r)_z.
    """
    ray = turned(other.camera.rotation.T, view.camera.rays(pixel_grid(seen.z.shape))).reshape(*seen.z.shape, 3)
    t = other.camera.rotation.T @ (view.camera.center - other.camera.center)
    ahead = ray[..., 2] > 0
    across = t[:2] * ray[..., 2:] - t[2] * ray[..., :2]
    way = np.hypot(other.camera.fx * across[..., 0], other.camera.fy * across[..., 1])
    return np.where(ahead, way / (seen.z * np.where(ahead, ray[..., 2], 1.0)), np.inf)


def pixels_per_inverse_depth(view: FittedView, other: FittedView) -> float:
    """By how far the other view sees a point move where the way between the two lies across, per unit of 1/z.

    With t the way in the axes of the other view this is sqrt((fx t_x)^2 + (fy t_y)^2 + fx fy t_z^2): what leads forward
    counts as if it lay across. It is written as fx |t| times a root that is exactly 1 where pixels are square.
    """
    lens, way = other.camera, view.camera.center - other.camera.center
    length = float(np.linalg.norm(way))
    if length == 0:
        return 0.0
    _, down, forward = lens.rotation.T @ (way / length)
    tall = lens.fy / lens.fx
    return lens.fx * length * float(np.sqrt(1 + (tall - 1) * ((tall + 1) * down**2 + forward**2)))


def from_elsewhere(views: Sequence[FittedView], index: int, depth: F64) -> dict[int, float]:
    """The other views by number, and for each the `pixels_per_inverse_depth`; none with less than LEAST_WAY of the
    most, unless what has the view's middle z-depth, of `depth` (H, W), moves by PARALLAX_PX in it: an overview from far
    away makes a pair of neighbours no worse. None at all where all are from the same place."""
    ways = {
        other: pixels_per_inverse_depth(views[index], views[other]) for other in range(len(views)) if other != index
    }
    mask = views[index].mask
    middle = float(np.median(depth if mask is None or not mask.any() else depth[mask]))
    least = min(LEAST_WAY * max(ways.values()), PARALLAX_PX * middle)
    return {other: way for other, way in ways.items() if way > 0 and way >= least}
