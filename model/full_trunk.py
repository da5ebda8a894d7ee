"""The full multi-view trunk of the paper: UniMatch's CNN and transformer, frozen, as DepthSplat has them too."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .config import ModelConfig
from .cost_volume import Views
from .depthsplat.cnn import CnnEncoder
from .depthsplat.config import CNN_CHANNELS, FEATURES
from .depthsplat.neighbours import nearest_views, neighbour_rows
from .depthsplat.transformer import MultiViewTransformer, with_positions
from .gradients import no_gradient
from .trunk import TrunkFeatures
from .vit import normalised_for_vit

HALF_CHANNELS = CNN_CHANNELS[1]
QUARTER_CHANNELS = CNN_CHANNELS[2] + FEATURES  # texture beside what the neighbours know of it


class FullTrunk(nn.Module):
    """F_CNN of Eq. 1 with pretrained weights (`pretrained.trunk.load_trunk`); its parts carry their published names."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        found = (config.half_channels, config.quarter_channels)
        if found != (HALF_CHANNELS, QUARTER_CHANNELS):
            raise ValueError(
                f"half and quarter channels are {found}, the full trunk has {HALF_CHANNELS, QUARTER_CHANNELS}"
            )
        self.frozen = config.freeze_vits
        self.backbone = CnnEncoder()
        self.transformer = MultiViewTransformer()
        if self.frozen:
            self.requires_grad_(False)

    def forward(self, images: Tensor, views: Views) -> TrunkFeatures:
        """images (B*V, 3, H, W) in [0, 1]; each view is compared with its two nearest neighbours."""
        with no_gradient(self.frozen):
            _, half, texture = self.backbone(normalised_for_vit(images))
            rows = neighbour_rows(nearest_views(views.world_from_cam, as_listed=False))
            multi_view = self.transformer(with_positions(texture), rows)
        return TrunkFeatures(half, torch.cat([texture, multi_view], dim=1))
