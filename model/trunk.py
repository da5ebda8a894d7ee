"""The light multi-view trunk: a CNN at 1/2 and 1/4 resolution with cross-view attention at 1/8."""

from __future__ import annotations

from dataclasses import dataclass

import torch.nn.functional as F
from torch import Tensor, nn

from .config import ModelConfig
from .cost_volume import Views
from .geometry import other_views
from .layers import ResidualBlock, resize_to


@dataclass(frozen=True)
class TrunkFeatures:
    """CNN features of B * V views, views already aware of each other."""

    half: Tensor  # (B*V, c2, H/2, W/2)
    quarter: Tensor  # (B*V, c4, H/4, W/4)


class CrossViewBlock(nn.Module):
    """Self-attention within a view, attention to all other views, and a feed-forward layer.

    Keys and values are pooled by two, which quarters the cost and the memory of both attentions.
    """

    def __init__(self, channels: int, heads: int = 4) -> None:
        super().__init__()
        if channels % heads:
            raise ValueError(f"eighth_channels is {channels}, need a multiple of {heads}: attention has so many heads")
        self.heads = heads
        self.position = nn.Conv2d(channels, channels, 3, padding=1, groups=channels)
        self.norm_self = nn.LayerNorm(channels)
        self.norm_cross = nn.LayerNorm(channels)
        self.norm_mlp = nn.LayerNorm(channels)
        self.query_self = nn.Linear(channels, channels)
        self.key_value_self = nn.Linear(channels, 2 * channels)
        self.out_self = nn.Linear(channels, channels)
        self.query_cross = nn.Linear(channels, channels)
        self.key_value_cross = nn.Linear(channels, 2 * channels)
        self.out_cross = nn.Linear(channels, channels)
        self.mlp = nn.Sequential(nn.Linear(channels, 2 * channels), nn.GELU(), nn.Linear(2 * channels, channels))

    def forward(self, x: Tensor, views: int) -> Tensor:
        """x (B*V, C, h, w) -> same shape."""
        n, c, h, w = x.shape
        x = x + self.position(x)
        tokens = x.flatten(2).transpose(1, 2)
        own = self._pooled(self.norm_self(tokens), h, w)
        tokens = tokens + self.out_self(self._attend(self.query_self(self.norm_self(tokens)), self.key_value_self(own)))
        pooled = self._pooled(self.norm_cross(tokens), h, w)
        others = other_views(pooled.reshape(-1, views, *pooled.shape[1:]))  # (B, V, V-1, T, C)
        others = others.reshape(n, -1, c)
        tokens = tokens + self.out_cross(
            self._attend(self.query_cross(self.norm_cross(tokens)), self.key_value_cross(others))
        )
        tokens = tokens + self.mlp(self.norm_mlp(tokens))
        return tokens.transpose(1, 2).reshape(n, c, h, w)

    def _pooled(self, tokens: Tensor, h: int, w: int) -> Tensor:
        grid = tokens.transpose(1, 2).reshape(tokens.shape[0], tokens.shape[2], h, w)
        return F.avg_pool2d(grid, 2).flatten(2).transpose(1, 2)

    def _attend(self, query: Tensor, key_value: Tensor) -> Tensor:
        n, t, c = query.shape
        size = c // self.heads
        q = query.reshape(n, t, self.heads, size).transpose(1, 2)
        kv = key_value.reshape(n, -1, 2, self.heads, size).permute(2, 0, 3, 1, 4)
        logits = (q @ kv[0].transpose(-1, -2)) * size**-0.5
        return (logits.softmax(-1) @ kv[1]).transpose(1, 2).reshape(n, t, c)


class LightTrunk(nn.Module):
    """F_CNN of Eq. 1: local texture at 1/2 and 1/4 resolution, informed by the other views."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        c2, c4, c8 = config.half_channels, config.quarter_channels, config.eighth_channels
        self.to_half = nn.Conv2d(3, c2, 5, stride=2, padding=2)
        self.at_half = ResidualBlock(c2)
        self.to_quarter = nn.Conv2d(c2, c4, 3, stride=2, padding=1)
        self.at_quarter = nn.Sequential(ResidualBlock(c4), ResidualBlock(c4))
        self.to_eighth = nn.Conv2d(c4, c8, 3, stride=2, padding=1)
        self.cross_view = nn.ModuleList([CrossViewBlock(c8) for _ in range(config.cross_view_blocks)])
        self.from_eighth = nn.Conv2d(c8, c4, 1)

    def forward(self, images: Tensor, views: Views) -> TrunkFeatures:
        """images (B*V, 3, H, W) in [0, 1]."""
        half = self.at_half(F.relu(self.to_half(images * 2 - 1)))
        quarter = self.at_quarter(F.relu(self.to_quarter(half)))
        eighth = F.relu(self.to_eighth(quarter))
        for block in self.cross_view:
            eighth = block(eighth, views.count)
        return TrunkFeatures(half, quarter + resize_to(self.from_eighth(eighth), quarter))
