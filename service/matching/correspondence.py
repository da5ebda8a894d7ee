"""Reprojection of one view's pixels into another by their depths, and the parallax that they have there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera, pixel_grid
from ..cameras.rotations import rotated
from ..photographs.bilinear import bilinear
from ..photographs.images import FittedView
from .reprojection_kernels import reproject_pixels, sample_bilinear

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

PARALLAX_PX = 4.0  # against infinity; with less any depth seems right
LEAST_BASELINE = 0.05  # of the longest baseline: a view from nearly the same place says nothing about depth
KEPT = 0.999  # bilinear weight of kept pixels above which, up to rounding, no masked pixel takes part


@dataclass(frozen=True, eq=False)
class Reprojection:
    """The pixels (H, W) of one view, reprojected into another."""

    column: F64  # (H, W) real-valued pixel index: 0 is the centre of the first pixel
    row: F64  # (H, W), likewise
    z: F64  # (H, W) z-depth in the other view; 1 outside `where`
    inside: Mask  # (H, W) in front of the other view and within its picture
    where: Mask  # (H, W) `inside`, and no masked pixel among the four around it

    def value(self, picture: NDArray[np.floating]) -> NDArray[np.floating]:
        """(H, W, C) bilinear samples of a `picture` (h, w, C) of the other view, in its precision."""
        values = np.ascontiguousarray(picture)
        found = np.empty((*self.z.shape, picture.shape[2]), picture.dtype)
        sample_bilinear(values, self.column, self.row, found)
        return found


def reprojected(view: FittedView, depth: F64, other: FittedView) -> Reprojection:
    """The pixels of `view` at z-depths `depth` (H, W), in the cameras' units, as `other` sees them."""
    column, row, z = (np.empty(depth.shape) for _ in range(3))
    inside = np.empty(depth.shape, np.bool_)
    (lens, pose), (other_lens, other_pose) = _lens_and_pose(view.camera), _lens_and_pose(other.camera)
    size = np.array([other.camera.width, other.camera.height], np.float64)
    depth = np.ascontiguousarray(depth, np.float64)
    reproject_pixels(depth, lens, pose, other_lens, other_pose, size, column, row, z, inside.view(np.uint8))
    where = inside
    if other.mask is not None:
        where = inside & (bilinear(other.mask.astype(np.float32)[..., None], column, row)[..., 0] > KEPT)
    return Reprojection(column, row, np.where(where, z, 1.0), inside, where)


def _lens_and_pose(camera: Camera) -> tuple[F64, F64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy]), np.ascontiguousarray(camera.world_from_cam[:3])


def disagreement(view: FittedView, seen: Reprojection, other: FittedView, other_depth: F64) -> F64:
    """(H, W) px of parallax between a pixel's depth in the other view and that view's own depth `other_depth` (h, w)
    at the same place."""
    theirs = seen.value(other_depth[..., None])[..., 0]
    return np.abs(1 / seen.z - 1 / theirs) * pixels_per_inverse_depth(view, other)


def parallax(view: FittedView, seen: Reprojection, other: FittedView) -> F64:
    """(H, W) distance in px, in the other view, between a pixel's reprojection and that of its ray's point at infinity.

    0 at the epipole, whatever the baseline; infinite where the point at infinity lies behind the other view. With t the
    centre of `view` and r the pixel's ray, both in the axes of `other`, (t + d r) / z - r / r_z is
    (t r_z - r t_z) / (r_z z), where z is (t + d r)_z.
    """
    ray = rotated(other.camera.rotation.T, view.camera.rays(pixel_grid(seen.z.shape))).reshape(*seen.z.shape, 3)
    t = other.camera.rotation.T @ (view.camera.center - other.camera.center)
    ahead = ray[..., 2] > 0
    across = t[:2] * ray[..., 2:] - t[2] * ray[..., :2]
    shift = np.hypot(other.camera.fx * across[..., 0], other.camera.fy * across[..., 1])
    return np.where(ahead, shift / (seen.z * np.where(ahead, ray[..., 2], 1.0)), np.inf)


def pixels_per_inverse_depth(view: FittedView, other: FittedView) -> float:
    """Disparity in px of the other view per unit of inverse depth, as if the baseline were perpendicular to its axis.

    With t the baseline in the axes of the other view this is sqrt((fx t_x)^2 + (fy t_y)^2 + fx fy t_z^2): the part
    along the axis counts as if it were across. Computed as fx |t| times a root that is exactly 1 for square pixels.
    """
    lens, baseline = other.camera, view.camera.center - other.camera.center
    length = float(np.linalg.norm(baseline))
    if length == 0:
        return 0.0
    _, down, forward = lens.rotation.T @ (baseline / length)
    tall = lens.fy / lens.fx
    return lens.fx * length * float(np.sqrt(1 + (tall - 1) * ((tall + 1) * down**2 + forward**2)))


def views_with_parallax(views: Sequence[FittedView], index: int, depth: F64) -> dict[int, float]:
    """The other views that have parallax to view `index`: index -> `pixels_per_inverse_depth`.

    Left out are those below LEAST_BASELINE of the largest, unless a point at the median of the z-depths `depth` (H, W)
    has PARALLAX_PX in them: a distant overview does not make a pair of neighbours worse. Empty where all views are from
    one place."""
    others = [other for other in range(len(views)) if other != index]
    scales = {other: pixels_per_inverse_depth(views[index], views[other]) for other in others}
    kept = views[index].kept
    middle = float(np.median(depth[kept] if kept.any() else depth))
    least = min(LEAST_BASELINE * max(scales.values()), PARALLAX_PX * middle)
    return {other: scale for other, scale in scales.items() if scale > 0 and scale >= least}
