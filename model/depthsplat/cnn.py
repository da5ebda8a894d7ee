"""The CNN of UniMatch: texture at 1/2, 1/2 and 1/4 resolution, or at 1/2, 1/4 and 1/8."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from ..normalisation import InstanceNorm
from .config import CNN_CHANNELS, FEATURES


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with instance normalisation, and the input added."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.norm = InstanceNorm(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride=stride), InstanceNorm(outputs))

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.norm(self.conv1(x)))
        y = F.relu(self.norm(self.conv2(y)))
        return F.relu((x if self.downsample is None else self.downsample(x)) + y)


class CnnEncoder(nn.Module):
    """Texture features, independent of the other views."""

    def __init__(self, coarsest: int = 4) -> None:
        super().__init__()
        first, second, third = CNN_CHANNELS
        self.conv1 = nn.Conv2d(3, first, 7, stride=2, padding=3, bias=False)
        self.norm = InstanceNorm(first)
        self.layer1 = nn.Sequential(ResidualBlock(first, first), ResidualBlock(first, first))
        self.layer2 = nn.Sequential(ResidualBlock(first, second, coarsest // 4), ResidualBlock(second, second))
        self.layer3 = nn.Sequential(ResidualBlock(second, third, stride=2), ResidualBlock(third, third))
        self.conv2 = nn.Conv2d(third, FEATURES, 1)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(n, 3, H, W) normalised -> (n, 64, H/2, W/2), (n, 96, H/2, W/2), (n, 128, H/4, W/4); the last two at half
        of that where the coarsest resolution is 1/8."""
        first = self.layer1(F.relu(self.norm(self.conv1(images))))
        second = self.layer2(first)
        return first, second, self.conv2(self.layer3(second))
