"""DepthSplat: posed images to one Gaussian per pixel, under the same contract as GaPMeS, without routing."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..cost_volume import Views
from ..masking import kept
from ..prediction import Prediction
from .adapter import RAW_CHANNELS, gaussians_from_raw
from .config import FEATURE_HEAD, DepthSplatConfig
from .depth import MultiViewDepth
from .dpt import DptHead, replicate_conv

REGRESSOR_WIDTH = 64


class DepthSplat(nn.Module):
    """The public feed-forward network (Xu et al., "DepthSplat", 2024)."""

    gates = None  # nothing is routed

    def __init__(self, config: DepthSplatConfig) -> None:
        super().__init__()
        self.config = config
        features = FEATURE_HEAD[config.vit]
        self.depth_predictor = MultiViewDepth(config)
        self.feature_upsampler = DptHead(config, features, depth=False)
        self.gaussian_regressor = nn.Sequential(
            nn.Conv2d(3 + 1 + 1 + features, REGRESSOR_WIDTH, 3, padding=1),
            nn.GELU(),
            nn.Conv2d(REGRESSOR_WIDTH, REGRESSOR_WIDTH, 3, padding=1),
        )
        self.gaussian_head = nn.Sequential(
            replicate_conv(3 + features + REGRESSOR_WIDTH + 1, RAW_CHANNELS),
            nn.GELU(),
            replicate_conv(RAW_CHANNELS, RAW_CHANNELS),
        )

    def forward(
        self,
        images: Tensor,
        intrinsics: Tensor,
        world_from_cam: Tensor,
        near_far: Tensor,
        patch_mask: Tensor | None = None,
    ) -> Prediction:
        """As `GaPMeS.forward`; a patch that is left out gets opacity 0 and is computed all the same."""
        batch, count, _, height, width = images.shape
        flat = images.reshape(-1, 3, height, width)
        views = Views.make(intrinsics, world_from_cam, near_far)
        found = self.depth_predictor(flat, views)
        features = self.feature_upsampler(found.vit, found.cnn, found.multi_view)
        confidence = F.interpolate(found.probability.amax(1, keepdim=True), size=(height, width), mode="nearest")
        depth = 1 / found.inverse
        regressed = self.gaussian_regressor(torch.cat([flat, depth, confidence, features], dim=1))
        raw = self.gaussian_head(torch.cat([regressed, flat, features, confidence], dim=1))
        keep = kept(patch_mask, flat)[1]
        gaussians = gaussians_from_raw(flat, raw, depth, views, keep, self.config)
        maps = (batch, count, height, width)
        return Prediction(gaussians, depth.reshape(maps), confidence.reshape(maps), None)
