"""One picture seen from another camera through a depth map or a stack of planes."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gapmes.service.cameras.camera import Camera, pixel_grid
from gapmes.service.cameras.rotations import rotated
from gapmes.service.photographs.images import FittedView


def warped(camera: Camera, source: FittedView, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Backward warp of `source` into `camera` through surfaces at `depths`, without occlusion.

    depths: z-depths (D, H, W), or (D, 1, 1) for planes. Returns colours (D, 3, H, W), clamped to the border, and a mask
    (D, H, W) of points inside the source.
    """
    x, y, seen = source_positions(camera, source.camera, depths)
    grid = torch.stack([2 * x / source.camera.width - 1, 2 * y / source.camera.height - 1], dim=-1)
    image = torch.from_numpy(source.image)[None].expand(len(grid), -1, -1, -1)
    return F.grid_sample(image, grid, padding_mode="border", align_corners=False), seen


def source_positions(camera: Camera, source: Camera, depths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Pixel positions x, y (D, H, W) in `source` of the points at `depths`, and a mask of those in its picture."""
    rays, offset = relative_rays(camera, source)
    z = offset[2] + depths * rays[2]
    front = z > 0
    safe = torch.where(front, z, 1.0)
    x = source.fx * (offset[0] + depths * rays[0]) / safe + source.cx
    y = source.fy * (offset[1] + depths * rays[1]) / safe + source.cy
    return x, y, front & (x >= 0) & (x < source.width) & (y >= 0) & (y < source.height)


def relative_rays(camera: Camera, source: Camera) -> tuple[Tensor, list[float]]:
    """Rays (3, H, W) of `camera` and its centre, both in the frame of `source`; a point is centre + depth * ray."""
    shape = (camera.height, camera.width)
    rays = rotated(source.rotation.T, camera.rays(pixel_grid(shape))).T.reshape(3, *shape)
    offset = (camera.center - source.center) @ source.rotation
    return torch.from_numpy(rays.astype(np.float32)), [float(value) for value in offset]
