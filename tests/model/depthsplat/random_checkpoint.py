"""A DepthSplat checkpoint in the published layout with random weights, written from our own network's names."""

from __future__ import annotations

import re
from pathlib import Path

import torch
from torch import Tensor

from gapmes.model.depthsplat.checkpoint import VIT
from gapmes.model.depthsplat.config import DepthSplatConfig
from gapmes.model.depthsplat.network import DepthSplat

_OUTSIDE = {
    "embeddings.cls_token": "cls_token",
    "embeddings.position_embeddings": "pos_embed",
    "embeddings.patch_embeddings.projection.weight": "patch_embed.proj.weight",
    "embeddings.patch_embeddings.projection.bias": "patch_embed.proj.bias",
    "layernorm.weight": "norm.weight",
    "layernorm.bias": "norm.bias",
}
_INSIDE = {
    "attention.o_proj": "attn.proj",
    "layer_scale1.lambda1": "ls1.gamma",
    "layer_scale2.lambda1": "ls2.gamma",
}


def randomised(network: DepthSplat, seed: int = 0) -> DepthSplat:
    """Weights with a spread at which neither softmax nor sigmoid saturates and every part has an effect."""
    generator = torch.Generator().manual_seed(seed)
    for name, value in network.named_parameters():
        noise = torch.randn(value.shape, generator=generator)
        if value.dim() > 1:
            value.data = noise * (0.7 / value[0].numel() ** 0.5)
        else:
            scale = "norm" in name or "lambda" in name or name.endswith(("in_layers.0.weight", "out_layers.0.weight"))
            value.data = (1.0 if scale and not name.endswith("bias") else 0.0) + 0.1 * noise
    return network.eval()


def published_layout(network: DepthSplat) -> dict[str, Tensor]:
    """The tensors under the names of the authors' trainer, those of the ViT as in the original DINOv2."""
    tensors: dict[str, Tensor] = {}
    qkv: dict[str, dict[str, Tensor]] = {}
    for name, value in network.state_dict().items():
        inner = name.removeprefix(f"{VIT}vit.")
        if inner == name:
            tensors[f"encoder.{name}"] = value
        elif inner in _OUTSIDE:
            tensors[f"encoder.{VIT}{_OUTSIDE[inner]}"] = value
        elif match := re.fullmatch(r"encoder\.layer\.(\d+)\.attention\.([qkv])_proj\.(weight|bias)", inner):
            qkv.setdefault(f"encoder.{VIT}blocks.{match[1]}.attn.qkv.{match[3]}", {})[match[2]] = value
        elif match := re.fullmatch(r"encoder\.layer\.(\d+)\.(.+)", inner):
            rest = match[2]
            for ours, theirs in _INSIDE.items():
                rest = rest.replace(ours, theirs)
            tensors[f"encoder.{VIT}blocks.{match[1]}.{rest}"] = value
    return tensors | {name: torch.cat([parts[k] for k in "qkv"]) for name, parts in qkv.items()}


def write_checkpoint(folder: Path, vit: str = "small", scales: int = 1, coarsest: int = 4) -> tuple[Path, DepthSplat]:
    """A file as the authors' trainer saves it, and the network that it was made from."""
    network = randomised(DepthSplat(DepthSplatConfig(vit, scales, coarsest=coarsest)))
    path = folder / f"depthsplat-gs-{vit}.pth"
    torch.save({"state_dict": published_layout(network), "epoch": 3, "global_step": 9}, path)
    return path, network
