"""The full network with ViTs and widths small enough for tests; trunk and connections are those of the presets."""

from __future__ import annotations

from pathlib import Path

import torch

from gapmes.model.backbones import DepthAnythingFeatures
from gapmes.model.config import VitConfig, preset
from gapmes.model.network import GaPMeS
from gapmes.model.pretrained.backbones import BackboneSources

VIT = VitConfig(hidden=48, layers=4, heads=2, patch=14, mlp_ratio=2, image_size=56)


def miniature(seed: int = 0) -> GaPMeS:
    """An untrained network of preset `small` with miniature ViTs, in evaluation mode."""
    torch.manual_seed(seed)
    config = preset(
        "small",
        semantic_vit=VIT,
        depth_vit=VIT,
        match_channels=16,
        volume_channels=16,
        refine_channels=16,
        stream_channels=16,
        depth_planes=16,
    )
    return GaPMeS(config).eval()


def weights_of_another(folder: Path) -> BackboneSources:
    """Weights of another miniature (seed 9) as files in `folder`, in layouts that loaders know."""
    other = miniature(seed=9)
    assert isinstance(other.mono, DepthAnythingFeatures)
    semantic, depth, trunk = (folder / name for name in ("dino.pth", "depth.pth", "gmflow.pth"))
    torch.save(other.semantic.vit.state_dict(), semantic)
    torch.save(other.mono.model.state_dict(), depth)
    extra = {"feature_flow_attn.q_proj.weight": torch.zeros(2, 2)}
    torch.save({"model": other.trunk.state_dict() | extra}, trunk)
    return BackboneSources(str(semantic), str(trunk), str(depth))
