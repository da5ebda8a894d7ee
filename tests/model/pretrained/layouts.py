"""Small random networks, and their weights in the layouts of their publishers: the inverse of the loaders."""

from __future__ import annotations

import re
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from gapmes.model.backbones import DepthAnythingFeatures, VitFeatures
from gapmes.model.config import VitConfig

SMALL = VitConfig(hidden=48, layers=4, heads=4, patch=14, mlp_ratio=2, image_size=56)

State = dict[str, Tensor]

_TO_4 = {
    "attention.q_proj": "attention.attention.query",
    "attention.k_proj": "attention.attention.key",
    "attention.v_proj": "attention.attention.value",
    "attention.o_proj": "attention.output.dense",
}
_TO_ORIGINAL = {
    "embeddings.cls_token": "cls_token",
    "embeddings.mask_token": "mask_token",
    "embeddings.position_embeddings": "pos_embed",
    "embeddings.patch_embeddings.projection": "patch_embed.proj",
    "layernorm": "norm",
    "attention.o_proj": "attn.proj",
    "layer_scale1.lambda1": "ls1.gamma",
    "layer_scale2.lambda1": "ls2.gamma",
}
_HEAD_TO_ORIGINAL = {
    "head.conv1": "scratch.output_conv1",
    "head.conv2": "scratch.output_conv2.0",
    "head.conv3": "scratch.output_conv2.2",
}


def randomise(module: nn.Module, seed: int) -> None:
    """Weights with which every layer affects the output: a fresh head gives a nearly constant depth."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, p in module.named_parameters():
            if p.ndim == 4:
                p.normal_(0, (2 / p[0].numel()) ** 0.5, generator=generator)
            elif p.ndim == 2:
                p.normal_(0, p.shape[1] ** -0.5, generator=generator)
            elif name.endswith(("norm1.weight", "norm2.weight", "layernorm.weight", "lambda1")):
                p.uniform_(0.5, 1.5, generator=generator)
            else:
                p.normal_(0, 0.3, generator=generator)


def random_vit(seed: int = 0, config: VitConfig = SMALL) -> VitFeatures:
    features = VitFeatures(config, frozen=True).eval()
    randomise(features.vit, seed)
    return features


def random_depth_anything(seed: int = 0, config: VitConfig = SMALL) -> DepthAnythingFeatures:
    features = DepthAnythingFeatures(config, frozen=True).eval()
    randomise(features.model, seed)
    return features


def transformers_4(state: State) -> State:
    """The state under the names of transformers before version 5."""
    renamed = {}
    for name, value in state.items():
        for new, old in _TO_4.items():
            name = name.replace(new, old)
        renamed[name] = value
    return renamed


def original(state: State, *, chunk: int = 0) -> State:
    """The state under the names of DINOv2's own files; with `chunk`, of those trained in chunks of that many blocks."""
    renamed: State = {}
    for name, value in state.items():
        match = re.fullmatch(r"encoder\.layer\.(\d+)\.(.+)", name)
        rest = match[2] if match else name
        if rest.startswith(("attention.k_proj", "attention.v_proj")):
            continue
        if rest.startswith("attention.q_proj"):
            value = torch.cat([state[name.replace("q_proj", f"{which}_proj")] for which in "qkv"])
            rest = rest.replace("attention.q_proj", "attn.qkv")
        for new, old in _TO_ORIGINAL.items():
            rest = rest.replace(new, old) if rest.startswith(new) else rest
        if match:
            block = int(match[1])
            rest = f"blocks.{f'{block // chunk}.' if chunk else ''}{block}.{rest}"
        renamed[rest] = value
    return renamed


def original_depth_anything(state: State) -> State:
    """The state of transformers' model under the names of Depth-Anything-V2's own files."""
    encoder = {k.removeprefix("backbone."): v for k, v in state.items() if k.startswith("backbone.")}
    renamed = {f"pretrained.{name}": value for name, value in original(encoder).items()}
    for name, value in state.items():
        if name.startswith("backbone."):
            continue
        for new, old in _HEAD_TO_ORIGINAL.items():
            name = name.replace(new, old)
        name = re.sub(r"neck\.reassemble_stage\.layers\.(\d)\.projection", r"projects.\1", name)
        name = re.sub(r"neck\.reassemble_stage\.layers\.(\d)\.resize", r"resize_layers.\1", name)
        name = re.sub(r"neck\.convs\.(\d)", lambda m: f"scratch.layer{int(m[1]) + 1}_rn", name)
        name = re.sub(
            r"neck\.fusion_stage\.layers\.(\d)\.projection",
            lambda m: f"scratch.refinenet{4 - int(m[1])}.out_conv",
            name,
        )
        name = re.sub(
            r"neck\.fusion_stage\.layers\.(\d)\.residual_layer(\d)\.convolution(\d)",
            lambda m: f"scratch.refinenet{4 - int(m[1])}.resConfUnit{m[2]}.conv{m[3]}",
            name,
        )
        renamed[f"depth_head.{name}"] = value
    return renamed


def prefixed(prefix: str, state: State) -> State:
    return {prefix + name: value for name, value in state.items()}


def write(path: Path, state: State) -> Path:
    """Write safetensors or, by the extension, torch's format."""
    state = {name: value.detach().clone().contiguous() for name, value in state.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".safetensors":
        save_file(state, path)
    else:
        torch.save(state, path)
    return path


def equal(a: nn.Module, b: nn.Module) -> bool:
    """Whether all parameters are equal, bit for bit."""
    return all(torch.equal(x, y) for x, y in zip(a.parameters(), b.parameters(), strict=True))
