"""The U-Net that regularises a cost volume, with attention across all views at its coarsest level."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..normalisation import GroupNorm

GROUPS = 8
HEAD_CHANNELS = 32


class ResBlock(nn.Module):
    """Two normalised convolutions; the input added, by a 1x1 convolution where channels differ."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.in_layers = nn.Sequential(GroupNorm(GROUPS, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, padding=1))
        # the place of the dropout, which has no weights, is kept: the layout numbers it
        self.out_layers = nn.Sequential(
            GroupNorm(GROUPS, outputs), nn.SiLU(), nn.Identity(), nn.Conv2d(outputs, outputs, 3, padding=1)
        )
        self.skip_connection = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, x: Tensor, views: int) -> Tensor:
        return self.skip_connection(x) + self.out_layers(self.in_layers(x))


class CrossViewAttention(nn.Module):
    """Every cell attends to every cell of every view."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.heads = channels // HEAD_CHANNELS
        self.norm = GroupNorm(GROUPS, channels)
        self.qkv = nn.Conv1d(channels, 3 * channels, 1)
        self.proj_out = nn.Conv1d(channels, channels, 1)

    def forward(self, x: Tensor, views: int) -> Tensor:
        """(B * views, C, h, w) -> the same."""
        n, c, h, w = x.shape
        flat = x.reshape(n, c, -1)
        qkv = self.qkv(self.norm(flat)).reshape(-1, views, self.heads, 3, HEAD_CHANNELS, h * w)
        q, k, v = qkv.permute(3, 0, 2, 1, 5, 4).reshape(3, -1, self.heads, views * h * w, HEAD_CHANNELS)
        scale = HEAD_CHANNELS**-0.25
        out = ((q * scale) @ (k * scale).transpose(-1, -2)).softmax(-1) @ v  # (B, heads, views * T, ch)
        out = out.reshape(-1, self.heads, views, h * w, HEAD_CHANNELS).permute(0, 2, 1, 4, 3).reshape(n, c, -1)
        return (flat + self.proj_out(out)).reshape(n, c, h, w)


class Down(nn.Module):
    """Half the resolution by a strided convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor, views: int) -> Tensor:
        return self.op(x)


class Up(nn.Module):
    """Twice the resolution by repetition and a convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor, views: int) -> Tensor:
        return self.conv(F.interpolate(x, scale_factor=2.0, mode="nearest"))


class First(nn.Conv2d):
    """The first convolution, in the signature of the other parts."""

    def forward(self, x: Tensor, views: int) -> Tensor:  # type: ignore[override]
        return super().forward(x)


class UNet(nn.Module):
    """`levels` levels of one residual block each, all of the same width."""

    def __init__(self, channels: int, levels: int) -> None:
        super().__init__()
        self.input_blocks = nn.ModuleList([nn.ModuleList([First(channels, channels, 3, padding=1)])])
        for level in range(levels):
            self.input_blocks.append(self._level(channels, channels, attention=level == levels - 1))
            if level < levels - 1:
                self.input_blocks.append(nn.ModuleList([Down(channels)]))
        # the layout numbers a part without weights between the two
        self.middle_block = nn.ModuleList([ResBlock(channels, channels), _Pass(), ResBlock(channels, channels)])
        self.output_blocks = nn.ModuleList()
        for level in reversed(range(levels)):
            for second in (False, True):
                block = self._level(2 * channels, channels, attention=level == levels - 1)
                if second and level > 0:
                    block.append(Up(channels))
                self.output_blocks.append(block)
        self.out = nn.Sequential(GroupNorm(GROUPS, channels), nn.SiLU(), nn.Conv2d(channels, channels, 3, padding=1))

    @staticmethod
    def _level(inputs: int, outputs: int, *, attention: bool) -> nn.ModuleList:
        return nn.ModuleList([ResBlock(inputs, outputs), *([CrossViewAttention(outputs)] if attention else [])])

    def forward(self, x: Tensor, views: int) -> Tensor:
        """(B * views, C, h, w) -> the same; h and w multiples of 2 ** (levels - 1)."""
        skips = []
        for block in self.input_blocks:
            x = _through(block, x, views)
            skips.append(x)
        x = _through(self.middle_block, x, views)
        for block in self.output_blocks:
            x = _through(block, torch.cat([x, skips.pop()], dim=1), views)
        return self.out(x)


class _Pass(nn.Identity):
    def forward(self, x: Tensor, views: int) -> Tensor:  # type: ignore[override]
        return x


def _through(parts: nn.Module, x: Tensor, views: int) -> Tensor:
    for part in parts.children():
        x = part(x, views)
    return x
