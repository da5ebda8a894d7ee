"""What every vision transformer here is built from: transformers' Dinov2Model, and the pictures' scale."""

from __future__ import annotations

import torch
from torch import Tensor
from transformers import Dinov2Config, Dinov2Model

from .config import VitConfig

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def dinov2_config(config: VitConfig, **more: object) -> Dinov2Config:
    return Dinov2Config(
        hidden_size=config.hidden,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        mlp_ratio=config.mlp_ratio,
        image_size=config.image_size,
        patch_size=config.patch,
        attn_implementation="eager",  # type: ignore[call-arg]  # a dataclass that takes further keywords
        **more,  # type: ignore[arg-type]
    )


def dinov2(config: VitConfig) -> Dinov2Model:
    """With random weights."""
    vit = Dinov2Model(dinov2_config(config))
    assert vit.embeddings.mask_token is not None
    vit.embeddings.mask_token.requires_grad_(False)  # only used by masked pretraining
    return vit


def normalised_for_vit(images: Tensor) -> Tensor:
    """(n, 3, H, W) in [0, 1] to zero mean and unit deviation over ImageNet."""
    mean, std = (torch.tensor(x, device=images.device).reshape(1, 3, 1, 1) for x in (IMAGENET_MEAN, IMAGENET_STD))
    return (images - mean) / std
