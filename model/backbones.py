"""The two vision transformers (transformers' Dinov2Model): global semantics, and monocular depth cues."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from transformers import Dinov2Config, Dinov2Model

from .config import PIXELS_PER_PATCH, VitConfig

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)


class VitFeatures(nn.Module):
    """Patch features of a Dinov2-type ViT on a grid of one token per 16 x 16 input pixels.

    Serves as F_dino with DINOv2 weights and as F_mono with the encoder of Depth-Anything-V2, which is the same class.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: VitConfig, *, frozen: bool) -> None:
        super().__init__()
        self.config = config
        self.frozen = frozen
        self.vit = Dinov2Model(
            Dinov2Config(
                hidden_size=config.hidden,
                num_hidden_layers=config.layers,
                num_attention_heads=config.heads,
                mlp_ratio=config.mlp_ratio,
                image_size=config.image_size,
                patch_size=config.patch,
                attn_implementation="eager",  # type: ignore[call-arg]  # a dataclass that takes further keywords
            )
        )
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN).reshape(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD).reshape(1, 3, 1, 1), persistent=False)
        assert self.vit.embeddings.mask_token is not None
        self.vit.embeddings.mask_token.requires_grad_(False)  # only used by masked pretraining
        if frozen:
            self.vit.requires_grad_(False)

    def forward(self, images: Tensor) -> Tensor:
        """(n, 3, H, W) in [0, 1] -> (n, hidden, H/16, W/16)."""
        height, width = images.shape[-2] // PIXELS_PER_PATCH, images.shape[-1] // PIXELS_PER_PATCH
        x = (images - self.mean) / self.std
        if self.config.patch != PIXELS_PER_PATCH:
            size = (height * self.config.patch, width * self.config.patch)
            x = F.interpolate(x, size=size, mode="bilinear", align_corners=False, antialias=False)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.frozen):
            tokens = self.vit(pixel_values=x).last_hidden_state[:, 1:]
        return tokens.transpose(1, 2).reshape(-1, self.config.hidden, height, width)
