"""The ViT whose intermediate tokens DepthSplat reads as monocular features (DINOv2's)."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from ..vit import Vit
from .config import TAPS, VITS

POSITION_OFFSET = 0.1  # cells, in the published code's resampling of the position embedding


class IntermediateVit(nn.Module):
    """Four layers' tokens on the grid of 1/8 resolution."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.config, self.taps = VITS[name], TAPS[name]
        self.vit = Vit(self.config, offset=POSITION_OFFSET)

    def seen_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width that pictures are resized to: whole patches."""
        return height // self.config.patch * self.config.patch, width // self.config.patch * self.config.patch

    def forward(self, images: Tensor) -> list[Tensor]:
        """(n, 3, H, W) normalised -> four maps (n, hidden, H/8, W/8)."""
        height, width = images.shape[-2:]
        size = self.seen_size(height, width)
        rows, columns = size[0] // self.config.patch, size[1] // self.config.patch
        seen = F.interpolate(images, size=size, mode="bilinear", align_corners=True)
        layers = self.vit.tokens(seen)
        maps = []
        for tap in self.taps:
            tokens = self.vit.layernorm(layers[tap])[:, 1:]
            grid = tokens.transpose(1, 2).reshape(-1, self.config.hidden, rows, columns)
            maps.append(F.interpolate(grid, size=(height // 8, width // 8), mode="bilinear", align_corners=True))
        return maps
