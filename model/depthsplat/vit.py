"""The ViT whose intermediate tokens DepthSplat reads as monocular features (transformers' Dinov2Model)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from transformers.models.dinov2.modeling_dinov2 import Dinov2Embeddings

from ..vit_parts import dinov2
from .config import TAPS, VITS

POSITION_OFFSET = 0.1  # cells, in the published code's resampling of the position embedding


def resampled_positions(table: Tensor, rows: int, columns: int) -> Tensor:
    """(1, 1 + M * M, C) position embedding -> (1, 1 + rows * columns, C), bicubic.

    The scale carries an offset as in the code that the weights were trained with, which moves every sample by up to 0.1
    cells; with M rows and columns it is the table itself.
    """
    side = round((table.shape[1] - 1) ** 0.5)
    if (rows, columns) == (side, side):
        return table
    grid = table[:, 1:].reshape(1, side, side, -1).permute(0, 3, 1, 2)
    scale = ((rows + POSITION_OFFSET) / side, (columns + POSITION_OFFSET) / side)
    resampled = F.interpolate(grid, scale_factor=scale, mode="bicubic", align_corners=False)
    return torch.cat([table[:, :1], resampled.permute(0, 2, 3, 1).reshape(1, rows * columns, -1)], dim=1)


class _OffsetEmbeddings(Dinov2Embeddings):
    """Where a fixed size is exported, a constant takes the place of this (export/graph.py)."""

    def interpolate_pos_encoding(self, embeddings: Tensor, height: int, width: int) -> Tensor:
        patch = self.patch_size
        assert isinstance(patch, int)
        return resampled_positions(self.position_embeddings, height // patch, width // patch)


class IntermediateVit(nn.Module):
    """Four layers' tokens on the grid of 1/8 resolution."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.config, self.taps = VITS[name], TAPS[name]
        self.vit = dinov2(self.config)
        self.vit.embeddings.__class__ = _OffsetEmbeddings  # the same tensors, read with the offset

    def seen_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width that pictures are resized to: whole patches."""
        return height // self.config.patch * self.config.patch, width // self.config.patch * self.config.patch

    def forward(self, images: Tensor) -> list[Tensor]:
        """(n, 3, H, W) normalised -> four maps (n, hidden, H/8, W/8)."""
        height, width = images.shape[-2:]
        size = self.seen_size(height, width)
        rows, columns = size[0] // self.config.patch, size[1] // self.config.patch
        seen = F.interpolate(images, size=size, mode="bilinear", align_corners=True)
        layers = self.vit(pixel_values=seen, output_hidden_states=True).hidden_states
        maps = []
        for tap in self.taps:
            tokens = self.vit.layernorm(layers[tap])[:, 1:]
            grid = tokens.transpose(1, 2).reshape(-1, self.config.hidden, rows, columns)
            maps.append(F.interpolate(grid, size=(height // 8, width // 8), mode="bilinear", align_corners=True))
        return maps
