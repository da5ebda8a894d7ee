"""From a prediction to pictures: Gaussians as the differentiable splatter wants them."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from gapmes.service.harmonics import C0

from ..adapter import GaussianBatch
from ..geometry import quaternion_to_matrix
from ..harmonics import evaluate
from .splat import splat


def draw(
    gaussians: GaussianBatch,
    world_from_cam: Tensor,
    intrinsics: Tensor,
    height: int,
    width: int,
    *,
    near: float,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Tensor, Tensor]:
    """rgb (B, T, 3, H, W) and alpha (B, T, 1, H, W); K (B, T, 3, 3) normalised by width and height."""
    factors = quaternion_to_matrix(gaussians.rotations_wxyz) * gaussians.scales.unsqueeze(-2)
    pixels = intrinsics * intrinsics.new_tensor([width, height, 1.0]).reshape(1, 1, 3, 1)
    common = (gaussians.means, factors, gaussians.opacities)
    if gaussians.harmonics.shape[2] == 1:
        colours = (0.5 + C0 * gaussians.harmonics[:, :, 0]).clamp(min=0)
        return splat(*common, colours, world_from_cam, pixels, height, width, near=near, background=background)
    rgb, alpha = [], []
    for target in range(world_from_cam.shape[1]):
        pose = world_from_cam[:, target : target + 1]
        directions = F.normalize(gaussians.means - pose[:, 0, None, :3, 3].to(gaussians.means.dtype), dim=-1)
        colours = evaluate(gaussians.harmonics, directions).clamp(min=0)
        k = pixels[:, target : target + 1]
        one = splat(*common, colours, pose, k, height, width, near=near, background=background)
        rgb.append(one[0])
        alpha.append(one[1])
    return torch.cat(rgb, dim=1), torch.cat(alpha, dim=1)
