"""The plane sweep at one scale: correlation of every cell with its neighbours at candidate depths."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..cost_volume import Views
from ..geometry import camera_rays, pixel_grid, rigid_inverse
from ..warp import FRONT, OUTSIDE, Warp
from .config import Compatibility
from .neighbours import neighbour_rows

LEAST_DEPTH = 1e-3  # in the cameras' units; what `clamped_depths` divides by at least
PIECE_CELLS = 512  # of the reference in one matrix product: its size bounds the memory of a correlation map


def plane_sweep(
    features: Tensor, inverse: Tensor, views: Views, neighbours: Tensor, compatibility: Compatibility
) -> Tensor:
    """Mean over the neighbours of <reference, source> / sqrt(C) at candidates of 1/z.

    features (n, C, h, w) of n = B * V views; inverse (n, D, 1, 1) or (n, D, h, w), 1 / world units; neighbours
    (B, V, m).
    A point outside the source view counts as 0. Correlates first and samples the correlation along the epipolar line,
    which is the same sum in another order, since bilinear sampling is linear. Returns (n, D, h, w).
    """
    n, channels, h, w = features.shape
    planes = inverse.shape[1]
    rows, count = neighbour_rows(neighbours), neighbours.shape[-1]
    reference_k, source_k, motion = _pairs(views, rows, count)
    half_cell = 0.5 if compatibility.corner_pixels else 0.0
    size = torch.tensor([w, h], dtype=features.dtype, device=features.device)
    grid = pixel_grid(h, w, features.device).unsqueeze(0) - half_cell / size.reshape(1, 2, 1, 1)
    rays = camera_rays(grid.expand(reference_k.shape[0], -1, -1, -1), reference_k)
    target_k = reference_k if compatibility.reference_intrinsics else source_k
    warp = Warp.make(rays.flatten(2).unsqueeze(3), target_k, motion)
    per_cell = inverse.shape[-1] > 1
    source = features.index_select(0, rows).flatten(2)  # (n * m, C, h * w)
    pieces = []
    step = max(1, PIECE_CELLS // w)
    for start in range(0, h, step):
        stop = min(h, start + step)
        cells = (stop - start) * w
        depths = inverse[:, :, start:stop].flatten(2) if per_cell else inverse.flatten(2)
        depths = depths.transpose(1, 2).unsqueeze(1).expand(-1, count, -1, -1).flatten(0, 1)
        at, _ = warp.part(start * w, stop * w).positions(depths)
        if compatibility.clamped_depths:
            at = _clamped(at, rays[:, :, start:stop].flatten(2).unsqueeze(3), depths, target_k, motion)
        at = at + 2 * half_cell / size
        reference = features[:, :, start:stop].flatten(2).transpose(1, 2)  # (n, cells, C)
        reference = reference.unsqueeze(1).expand(-1, count, -1, -1).reshape(-1, cells, channels)
        sampled = F.grid_sample(
            (reference @ source).reshape(-1, 1, h, w),
            at.reshape(-1, planes, 1, 2),
            mode="bilinear",
            padding_mode="zeros",
            align_corners=False,
        )
        pieces.append(sampled.reshape(n, -1, cells, planes).mean(1))
    volume = torch.cat(pieces, dim=1) / channels**0.5
    return volume.transpose(1, 2).reshape(n, planes, h, w)


def _clamped(at: Tensor, rays: Tensor, inverse: Tensor, target_k: Tensor, motion: Tensor) -> Tensor:
    """The positions of `Warp`, where that gives none divided by a depth of `LEAST_DEPTH` at least."""
    rotated = (motion[:, :3, :3] @ rays.flatten(2)).reshape(rays.shape)
    x, y, z = (rotated[:, axis] + motion[:, axis, 3, None, None] * inverse for axis in range(3))
    least = LEAST_DEPTH * inverse  # like x, y and z times the inverse depth
    depth = torch.maximum(z, least)
    axes = []
    for axis, offset in enumerate((x, y)):
        focal, centre = target_k[:, axis, axis, None, None], target_k[:, axis, 2, None, None]
        clamped = 2 * (focal * offset + centre * z) / depth - 1
        axes.append(torch.where(clamped.abs() < OUTSIDE, clamped, OUTSIDE))
    return torch.where(((z < least) | (z <= FRONT)).unsqueeze(-1), torch.stack(axes, dim=-1), at)


def _pairs(views: Views, rows: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Reference and source K (n * m, 3, 3) and source_from_reference (n * m, 4, 4)."""
    intrinsics, poses = views.intrinsics.reshape(-1, 3, 3), views.world_from_cam.reshape(-1, 4, 4)
    repeated = [x.unsqueeze(1).expand(-1, count, -1, -1).reshape(-1, *x.shape[1:]) for x in (intrinsics, poses)]
    motion = rigid_inverse(poses.index_select(0, rows)) @ repeated[1]
    return repeated[0], intrinsics.index_select(0, rows), motion
