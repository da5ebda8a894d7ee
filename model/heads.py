"""The four task heads (Eq. 16): a learned 4x upsampling that meets a guide halfway, then each task's activation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import ModelConfig

SCALE_FLOOR = 0.25  # px footprint; below it the network lives on the renderer's dilation and falls apart when zoomed
SCALE_GAIN = 0.7  # px footprint per unit of softplus
COLOUR_GAIN = 0.5  # largest residual on an input pixel's colour
BAND_GAIN = 0.1  # largest coefficient of SH band 1; each further band has half of it


@dataclass(frozen=True)
class HeadOutputs:
    """Per pixel, n = B * V images."""

    offset: Tensor  # (n, 2, H, W) px in (-1, 1), shift of the centre within the image plane
    depth_step: Tensor  # (n, 1, H, W) in (-1, 1), correction in units of a plane of the sweep
    opacity: Tensor  # (n, 1, H, W) in (0, 1)
    scale: Tensor  # (n, 3, H, W) in units of the pixel footprint
    rotation: Tensor  # (n, 4, H, W) unit wxyz in the camera frame
    colour: Tensor  # (n, 3 * K, H, W): DC residual in colour units, then bands as coefficients


def unit_quaternions(raw: Tensor, identity: Tensor) -> Tensor:
    """(n, 4, H, W) of unit length; all zeros become the identity.

    Dividing by the largest component first keeps the squares away from underflow and overflow.
    """
    largest = raw.abs().amax(1, keepdim=True)
    scaled = raw / torch.where(largest > 0, largest, torch.ones_like(largest))
    scaled = torch.where(largest > 0, scaled, identity.expand_as(raw))
    return scaled / scaled.square().sum(1, keepdim=True).sqrt()


class TaskHead(nn.Module):
    """1x1 convolution and 2x shuffle, a 3x3 convolution over that and the half-resolution guide, 1x1 convolution and 2x
    shuffle."""

    def __init__(self, channels: int, guide_channels: int, outputs: int, width: int = 24) -> None:
        super().__init__()
        self.project = nn.Conv2d(channels, 4 * width, 1)
        self.join = nn.Conv2d(width + guide_channels, width, 3, padding=1)
        self.out = nn.Conv2d(width, 4 * outputs, 1)
        assert self.out.bias is not None
        with torch.no_grad():
            self.out.weight.mul_(0.1)
            self.out.bias.zero_()

    def forward(self, features: Tensor, guide: Tensor) -> Tensor:
        """(n, C, H/4, W/4) and (n, guide_channels, H/2, W/2) -> (n, outputs, H, W)."""
        half = F.pixel_shuffle(self.project(features), 2)
        return F.pixel_shuffle(self.out(F.relu(self.join(torch.cat([half, guide], dim=1)))), 2)


class Heads(nn.Module):
    """mu (centre), alpha (opacity), epsilon (covariance), c (colour)."""

    gains: Tensor
    identity: Tensor

    def __init__(self, config: ModelConfig, channels: int) -> None:
        super().__init__()
        self.coefficients = (config.sh_degree + 1) ** 2
        guide = config.refine_channels
        self.mu = TaskHead(channels, guide, 3)
        self.alpha = TaskHead(channels, guide, 1)
        self.epsilon = TaskHead(channels, guide, 7)
        self.colour = TaskHead(channels, guide, 3 * self.coefficients)
        gains = [COLOUR_GAIN] + [
            BAND_GAIN * 0.5 ** (band - 1) for band in range(1, config.sh_degree + 1) for _ in range(2 * band + 1)
        ]
        self.register_buffer("gains", torch.tensor(gains).repeat_interleave(3).reshape(1, -1, 1, 1), persistent=False)
        self.register_buffer("identity", torch.tensor([1.0, 0, 0, 0]).reshape(1, 4, 1, 1), persistent=False)

    def forward(self, maps: list[Tensor], guide: Tensor) -> HeadOutputs:
        """maps in the order of `routing.TASKS`."""
        mu = torch.tanh(self.mu(maps[0], guide))
        opacity = torch.sigmoid(self.alpha(maps[1], guide) * 2 + 1.5)
        epsilon = self.epsilon(maps[2], guide)
        scale = SCALE_FLOOR + SCALE_GAIN * F.softplus((epsilon[:, :3] * 3 - 1.5).clamp(max=20.0))
        rotation = unit_quaternions(epsilon[:, 3:] + self.identity, self.identity)
        colour = torch.tanh(self.colour(maps[3], guide)) * self.gains
        return HeadOutputs(mu[:, :2], mu[:, 2:], opacity, scale, rotation, colour)
