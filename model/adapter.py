"""The Gaussian adapter: per-pixel head outputs and depth to Gaussians in the world frame."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gapmes.service.harmonics import C0

from .cost_volume import Views
from .geometry import camera_rays, matrix_to_quaternion, pixel_grid, quaternion_product
from .harmonics import rotate_bands
from .heads import HeadOutputs


@dataclass(frozen=True)
class GaussianBatch:
    """N Gaussians for each of B scenes, in the frame of the poses that went in."""

    means: Tensor  # (B, N, 3)
    scales: Tensor  # (B, N, 3)
    rotations_wxyz: Tensor  # (B, N, 4)
    opacities: Tensor  # (B, N)
    harmonics: Tensor  # (B, N, K, 3)

    @staticmethod
    def join(parts: list[GaussianBatch]) -> GaussianBatch:
        return GaussianBatch(
            torch.cat([p.means for p in parts], dim=1),
            torch.cat([p.scales for p in parts], dim=1),
            torch.cat([p.rotations_wxyz for p in parts], dim=1),
            torch.cat([p.opacities for p in parts], dim=1),
            torch.cat([p.harmonics for p in parts], dim=1),
        )


def per_scene(values: Tensor, views: int) -> Tensor:
    """(B*V, M, ...) -> (B, V*M, ...)."""
    return values.reshape(-1, views * values.shape[1], *values.shape[2:])


def place(positions: Tensor, depth: Tensor, intrinsics: Tensor, world_from_cam: Tensor) -> Tensor:
    """World points (n, M, 3) of normalised image positions (n, 2, h, w) at z-depth (n, 1, h, w)."""
    points = (camera_rays(positions, intrinsics) * depth).flatten(2)
    world = world_from_cam[:, :3, :3] @ points + world_from_cam[:, :3, 3:]
    return world.transpose(1, 2)


def footprint(depth: Tensor, intrinsics: Tensor, height: int, width: int) -> Tensor:
    """Side of a pixel at z-depth (n, 1, h, w), world units: depth / focal length, geometric mean of x and y."""
    focal = (intrinsics[:, 0, 0] * width * intrinsics[:, 1, 1] * height).sqrt()
    return depth / focal.reshape(-1, 1, 1, 1)


def gaussians_from_heads(
    images: Tensor, heads: HeadOutputs, inverse: Tensor, views: Views, keep: Tensor
) -> tuple[GaussianBatch, Tensor]:
    """One Gaussian per pixel.

    images (n, 3, H, W); inverse (n, 1, H, W) normalised inverse depth already corrected; keep (n, 1, H, W), 0 leaves a
    pixel out by opacity exactly 0. Returns the Gaussians and the z-depth (n, 1, H, W).
    """
    n, _, height, width = images.shape
    intrinsics, poses = views.intrinsics.reshape(-1, 3, 3), views.world_from_cam.reshape(-1, 4, 4)
    depth = 1 / views.inverse_depth(inverse.clamp(min=0.0))
    size = torch.tensor([width, height], dtype=images.dtype, device=images.device).reshape(1, 2, 1, 1)
    positions = pixel_grid(height, width, images.device).unsqueeze(0) + heads.offset / size
    means = place(positions, depth, intrinsics, poses)
    scales = (heads.scale * footprint(depth, intrinsics, height, width)).flatten(2).transpose(1, 2)
    camera = matrix_to_quaternion(poses[:, :3, :3]).unsqueeze(1)
    rotations = quaternion_product(camera, heads.rotation.flatten(2).transpose(1, 2))
    coefficients = heads.colour.shape[1] // 3
    colour = heads.colour.flatten(2).transpose(1, 2).reshape(n, -1, coefficients, 3)
    pixels = images.flatten(2).transpose(1, 2).unsqueeze(2)
    dc = ((pixels + colour[:, :, :1]).clamp(-0.1, 1.1) - 0.5) / C0
    harmonics = dc
    if coefficients > 1:
        harmonics = torch.cat([dc, rotate_bands(colour[:, :, 1:], poses[:, :3, :3])], dim=2)
    opacities = (heads.opacity * keep).flatten(1)
    v = views.count
    batch = GaussianBatch(
        per_scene(means, v),
        per_scene(scales, v),
        per_scene(rotations, v),
        per_scene(opacities, v),
        per_scene(harmonics, v),
    )
    return batch, depth
