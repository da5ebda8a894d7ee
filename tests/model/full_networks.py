"""The full network with ViTs and widths small enough for tests; trunk and connections are those of the presets."""

from __future__ import annotations

import torch

from gapmes.model.config import VitConfig, preset
from gapmes.model.network import GaPMeS

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
