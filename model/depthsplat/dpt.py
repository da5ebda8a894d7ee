"""The DPT head (Ranftl et al. 2021) that joins ViT, CNN and multi-view features into a map of full resolution."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .config import CNN_CHANNELS, FEATURES, HEAD_WIDTHS, VITS, DepthSplatConfig

# Of each level of the head, which of the CNN's maps have its resolution.
TEXTURE = {4: ((0, 1), (2,), ()), 8: ((0,), (1,), (2,))}


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


def matched_levels(config: DepthSplatConfig) -> range:
    """Of the head's levels, 0 at 1/2 resolution, those that the network matches at, fine to coarse."""
    finest = config.upsample_factor.bit_length() - 2
    return range(finest, finest + config.scales)


def joined_channels(config: DepthSplatConfig, level: int, *, depth: bool) -> int:
    """How many channels one of the first three levels joins."""
    matched = matched_levels(config)
    channels = HEAD_WIDTHS[config.vit][level] + sum(CNN_CHANNELS[number] for number in TEXTURE[config.coarsest][level])
    if level in matched:
        channels += FEATURES if level == matched[-1] else FEATURES // 2
    return channels + int(depth and level == matched[0])


class DptHead(nn.Module):
    """Of one network; with `depth` it reads a depth and adds detail to it, without it gives features.

    What joins the ViT's map at each of the first three levels, at 1/2, 1/4 and 1/8 resolution, follows from where the
    network matches: texture of that level, multi-view features, and at the finest matched level the depth.
    """

    def __init__(self, config: DepthSplatConfig, channels: int, *, depth: bool) -> None:
        super().__init__()
        self.depth = depth
        widths, hidden = HEAD_WIDTHS[config.vit], VITS[config.vit].hidden
        self.texture, self.matched = TEXTURE[config.coarsest], matched_levels(config)
        self.concat_projects = nn.ModuleList(
            [nn.Conv2d(joined_channels(config, level, depth=depth), widths[level], 1) for level in range(3)]
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
        for level, project in enumerate(self.concat_projects):
            found = [multi_view[self.matched[-1] - level]] if level in self.matched else []
            found += [depth] if depth is not None and level == self.matched[0] else []
            # the layout's order of channels: the ViT's map is the last of the first level
            joined = [*found, maps[0]] if level == 0 else [maps[level], *found]
            maps[level] = project(torch.cat([*(cnn[number] for number in self.texture[level]), *joined], dim=1))
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
