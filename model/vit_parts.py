"""What every vision transformer here is built from: transformers' Dinov2Model, and the pictures' scale."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from transformers import AttentionInterface, Dinov2Config, Dinov2Model

from .config import VitConfig

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

ATTENTION = "every_token"  # the name under which transformers finds `attention_to_every_token`


def attention_to_every_token(
    module: nn.Module, query: Tensor, key: Tensor, value: Tensor, attention_mask: Tensor | None, **settings: object
) -> tuple[Tensor, None]:
    """query, key and value (n, heads, tokens, d) -> (n, tokens, heads, d).

    What transformers calls eager, without the mask that it adds to every score in an exported graph though it blocks
    none, and with the queries scaled, which are fewer than the scores.
    """
    assert attention_mask is None
    scale = settings["scaling"]
    assert isinstance(scale, float)
    weights = ((query * scale) @ key.transpose(-1, -2)).softmax(-1)
    return (weights @ value).transpose(1, 2), None


AttentionInterface.register(ATTENTION, attention_to_every_token)


def dinov2_config(config: VitConfig, **more: object) -> Dinov2Config:
    return Dinov2Config(
        hidden_size=config.hidden,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        mlp_ratio=config.mlp_ratio,
        image_size=config.image_size,
        patch_size=config.patch,
        attn_implementation=ATTENTION,  # type: ignore[call-arg]  # a dataclass that takes further keywords
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
