"""The DPT head (Ranftl et al. 2021) that joins ViT, CNN and multi-view features into a map of full resolution."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import CNN_CHANNELS, FEATURES, HEAD_WIDTHS, VITS


def replicate_conv(inputs: int, outputs: int) -> nn.Conv2d:
    """3x3, borders continued."""
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate")


class ConvUnit(nn.Module):
    """ReLU and convolution twice; the input added."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class Fusion(nn.Module):
    """Adds a finer map to what comes from below, and enlarges it."""

    def __init__(self, channels: int, *, joins: bool) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(channels, channels, 1)
        if joins:
            self.resConfUnit1 = ConvUnit(channels)
        self.resConfUnit2 = ConvUnit(channels)

    def forward(self, below: Tensor, finer: Tensor | None, size: tuple[int, int]) -> Tensor:
        if finer is not None:
            below = below + self.resConfUnit1(finer)
        out = self.resConfUnit2(below)
        return self.out_conv(F.interpolate(out, size=size, mode="bilinear", align_corners=True))


class Scratch(nn.Module):
    """The parts that the layout keeps under one name."""

    def __init__(self, widths: tuple[int, ...], channels: int, *, depth: bool) -> None:
        super().__init__()
        for number, width in enumerate(widths, start=1):
            setattr(self, f"layer{number}_rn", nn.Conv2d(width, channels, 3, padding=1, bias=False))
            setattr(self, f"refinenet{number}", Fusion(channels, joins=number < len(widths)))
        if depth:
            self.output_conv = nn.Sequential(
                replicate_conv(channels, channels // 2),
                nn.GELU(),
                replicate_conv(channels // 2, 16),
                nn.GELU(),
                nn.Conv2d(16, 1, 1),
            )


class DptHead(nn.Module):
    """Of one network size and number of scales; with `depth` it reads a depth and adds detail to it, without it gives
    features."""

    def __init__(self, vit: str, scales: int, channels: int, *, depth: bool) -> None:
        super().__init__()
        self.depth = depth
        widths, hidden = HEAD_WIDTHS[vit], VITS[vit].hidden
        texture, second, third = CNN_CHANNELS
        fine = FEATURES // 2 if scales == 2 else 0  # multi-view features at 1/2 resolution
        fine_depth, coarse_depth = int(depth and scales == 2), int(depth and scales == 1)
        self.concat_projects = nn.ModuleList(
            [
                nn.Conv2d(texture + second + widths[0] + fine + fine_depth, widths[0], 1),
                nn.Conv2d(third + widths[1] + FEATURES + coarse_depth, widths[1], 1),
                nn.Conv2d(widths[2], widths[2], 1),
            ]
        )
        self.projects = nn.ModuleList([nn.Conv2d(hidden, width, 1) for width in widths])
        self.resize_layers = nn.ModuleList(
            [
                nn.ConvTranspose2d(widths[0], widths[0], 4, stride=4),
                nn.ConvTranspose2d(widths[1], widths[1], 2, stride=2),
                nn.Identity(),
                nn.Conv2d(widths[3], widths[3], 3, stride=2, padding=1),
            ]
        )
        self.scratch = Scratch(widths, channels, depth=depth)

    def forward(
        self,
        vit: list[Tensor],
        cnn: tuple[Tensor, Tensor, Tensor],
        multi_view: list[Tensor],
        depth: Tensor | None = None,
    ) -> Tensor:
        """vit: four maps (n, hidden, H/8, W/8); cnn as `CnnEncoder` gives them; multi_view coarse to fine; depth (n, 1,
        h, w) at the finest matched resolution. Returns (n, 1 or channels, H, W)."""
        maps = [resize(project(x)) for x, project, resize in zip(vit, self.projects, self.resize_layers, strict=True)]
        extra = [] if depth is None else [depth]
        two = len(multi_view) == 2
        fine = [*multi_view[1:], *extra] if two else []
        maps[0] = self.concat_projects[0](torch.cat([cnn[0], cnn[1], *fine, maps[0]], dim=1))
        coarse = [multi_view[0]] if two else [multi_view[0], *extra]
        maps[1] = self.concat_projects[1](torch.cat([cnn[2], maps[1], *coarse], dim=1))
        maps[2] = self.concat_projects[2](maps[2])
        s = self.scratch
        layers = [getattr(s, f"layer{number}_rn")(x) for number, x in enumerate(maps, start=1)]
        x: Tensor | None = None
        for number in (4, 3, 2, 1):
            at = layers[number - 1]
            size = layers[number - 2].shape[-2:] if number > 1 else (2 * at.shape[-2], 2 * at.shape[-1])
            fusion = getattr(s, f"refinenet{number}")
            x = fusion(at, None, size) if x is None else fusion(x, at, size)
        assert x is not None
        return s.output_conv(x) if self.depth else x
