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

    def grid(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of whole patches, which pictures are resized to."""
        return height // self.config.patch, width // self.config.patch

    def forward(self, images: Tensor) -> list[Tensor]:
        """(n, 3, H, W) normalised -> four maps (n, hidden, H/8, W/8)."""
        height, width = images.shape[-2:]
        rows, columns = self.grid(height, width)
        size = (rows * self.config.patch, columns * self.config.patch)
        seen = F.interpolate(images, size=size, mode="bilinear", align_corners=True)
        maps = []
        for layer in self.vit.tokens(seen, self.taps):
            tokens = self.vit.layernorm(layer)[:, 1:]
            grid = tokens.transpose(1, 2).reshape(-1, self.config.hidden, rows, columns)
            maps.append(F.interpolate(grid, size=(height // 8, width // 8), mode="bilinear", align_corners=True))
        return maps
