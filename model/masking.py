"""Masks of patches as factors 1 or 0."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from .config import PIXELS_PER_PATCH


def kept(patch_mask: Tensor | None, images: Tensor) -> tuple[Tensor, Tensor]:
    """(B*V*P,) and (B*V, 1, H, W) factors for images (B*V, 3, H, W) and a mask (B, V, P), False leaves out."""
    rows, columns = images.shape[-2] // PIXELS_PER_PATCH, images.shape[-1] // PIXELS_PER_PATCH
    if patch_mask is None:
        patches = images.new_ones(images.shape[0], 1, rows, columns)
    else:
        patches = patch_mask.to(images.dtype).reshape(-1, 1, rows, columns)
    pixels = F.interpolate(patches, scale_factor=PIXELS_PER_PATCH, mode="nearest")
    return patches.reshape(-1), pixels
