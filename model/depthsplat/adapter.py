"""DepthSplat's numbers per pixel to Gaussians in the frame of the poses."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from gapmes.service.harmonics import C0

from ..adapter import GaussianBatch, per_scene, place
from ..cost_volume import Views
from ..geometry import matrix_to_quaternion, pixel_grid, quaternion_product
from ..harmonics import rotate_bands
from ..heads import unit_quaternions
from .config import SCALE_MIN, SH_DEGREE, DepthSplatConfig

COEFFICIENTS = (SH_DEGREE + 1) ** 2
RAW_CHANNELS = 1 + 2 + 3 + 4 + 3 * COEFFICIENTS  # opacity, offset, scale, rotation, harmonics
SCALE_SHIFT = 4.0  # softplus(raw - 4): small Gaussians to start with
BAND_GAINS = [1.0] + [0.1 * 0.25**band for band in range(1, SH_DEGREE + 1) for _ in range(2 * band + 1)]

# The authors turn with the basis whose band 1 is (x, y, z), without signs; the file format's is (-y, z, -x).
FOREIGN_AXES = (0, 1, 2)


def gaussians_from_raw(
    images: Tensor, raw: Tensor, depth: Tensor, views: Views, keep: Tensor, config: DepthSplatConfig
) -> GaussianBatch:
    """images (n, 3, H, W) in [0, 1]; raw (n, RAW_CHANNELS, H, W); depth and keep (n, 1, H, W)."""
    n, _, height, width = images.shape
    intrinsics, poses = views.intrinsics.reshape(-1, 3, 3), views.world_from_cam.reshape(-1, 4, 4)
    opacity, offset, scale, rotation, colour = raw.split((1, 2, 3, 4, 3 * COEFFICIENTS), dim=1)
    size = torch.tensor([width, height], dtype=images.dtype, device=images.device).reshape(1, 2, 1, 1)
    positions = pixel_grid(height, width, images.device).unsqueeze(0) + (offset.sigmoid() - 0.5) / size
    means = place(positions, depth, intrinsics, poses)
    scales = F.softplus(scale - SCALE_SHIFT).clamp(SCALE_MIN, config.scale_max).flatten(2).transpose(1, 2)

    identity = torch.tensor([1.0, 0.0, 0.0, 0.0], device=images.device).reshape(1, 4, 1, 1)
    wxyz = torch.cat([rotation[:, 3:], rotation[:, :3]], dim=1)  # stored as xyzw
    rotations = unit_quaternions(wxyz, identity).flatten(2).transpose(1, 2)
    if not config.compatibility.camera_rotations:
        rotations = quaternion_product(matrix_to_quaternion(poses[:, :3, :3]).unsqueeze(1), rotations)

    coefficients = colour.flatten(2).transpose(1, 2).reshape(n, -1, 3, COEFFICIENTS).transpose(2, 3)
    coefficients = coefficients * torch.tensor(BAND_GAINS, device=images.device).reshape(-1, 1)
    pixels = images.flatten(2).transpose(1, 2).unsqueeze(2)
    dc = coefficients[:, :, :1] + (pixels - 0.5) / C0
    turn = poses[:, :3, :3]
    bands = coefficients[:, :, 1:]
    if config.compatibility.foreign_harmonics:
        turned = rotate_bands(bands, turn, axes=FOREIGN_AXES, signed=False)
    else:
        turned = rotate_bands(bands, turn)

    opacities = (opacity.sigmoid() * keep).flatten(1)
    v = views.count
    return GaussianBatch(
        per_scene(means, v),
        per_scene(scales, v),
        per_scene(rotations, v),
        per_scene(opacities, v),
        per_scene(torch.cat([dc, turned], dim=2), v),
    )
