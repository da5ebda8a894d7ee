"""Small networks and scenes for the model tests."""

from __future__ import annotations

import math

import torch

from gapmes.model.config import ModelConfig, preset
from gapmes.model.network import GaPMeS


def tiny(seed: int = 0, **changes: object) -> GaPMeS:
    """An untrained tiny network in evaluation mode."""
    torch.manual_seed(seed)
    config: ModelConfig = preset("tiny", **changes)
    return GaPMeS(config).eval()


def scene(batch: int = 1, views: int = 2, size: int = 64, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """Random images, plausible cameras on an arc, near and far: images, K, poses, near_far."""
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(batch, views, 3, size, size, generator=generator)
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 0.95, 0.48], [0, 0, 1]]).repeat(batch, views, 1, 1)
    poses = torch.eye(4).repeat(batch, views, 1, 1)
    for v in range(views):
        c, s = math.cos(0.03 * v), math.sin(0.03 * v)
        poses[:, v, :3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        poses[:, v, :3, 3] = torch.tensor([0.15 * v, 0.02 * v, 0.01 * v])
    return images, intrinsics, poses, torch.tensor([[1.0, 10.0]]).repeat(batch, 1)


def random_rotation(generator: torch.Generator) -> torch.Tensor:
    """(3, 3) float64 rotation, uniform."""
    q, r = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    q = q * torch.sign(torch.diagonal(r))
    return q * torch.sign(torch.linalg.det(q))
