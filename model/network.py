"""The GaPMeS network: posed images to 3D Gaussians, with the routing that made them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .adapter import GaussianBatch, gaussians_from_heads
from .backbones import VitFeatures
from .backing import backing_layer
from .config import PIXELS_PER_PATCH, ModelConfig
from .cost_volume import Views
from .depth import DepthEstimate, DepthFromMatching
from .heads import HeadOutputs, Heads
from .layers import resize_to
from .routing import Routing
from .streams import PatchMixture
from .trunk import LightTrunk

INVERSE_DEPTH_LIMIT = 1.3  # normalised; a little nearer than `near` is allowed, the far end is clamped at 0


@dataclass(frozen=True)
class Prediction:
    """What one pass yields for B scenes of V views."""

    gaussians: GaussianBatch
    depth: Tensor  # (B, V, H, W) z-depth of the Gaussian of each pixel
    confidence: Tensor  # (B, V, H, W) probability of the best plane of the sweep
    estimate: DepthEstimate  # normalised inverse depths, for the depth losses
    final_inverse: Tensor  # (B*V, 1, H, W) normalised inverse depth after the head's correction
    heads: HeadOutputs
    routing: Routing | None


class GaPMeS(nn.Module):
    """Feed-forward Gaussian splatting with patch-level mixture of experts."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.trunk = LightTrunk(config)
        self.semantic = VitFeatures(config.semantic_vit, frozen=config.freeze_vits)
        self.mono = None if config.without_depth else VitFeatures(config.depth_vit, frozen=config.freeze_vits)
        mono = 0
        if self.mono is not None:
            mono = config.stream_channels
            self.mono_context = nn.Conv2d(config.depth_vit.hidden, mono, 1)
        self.depth = DepthFromMatching(config, mono)
        channels = {"texture": config.quarter_channels, "semantic": config.semantic_vit.hidden}
        if self.mono is not None:
            channels["depth"] = mono + config.volume_channels + 2
        self.mixture = PatchMixture(config, channels)
        self.heads = Heads(config, self.mixture.channels)

    def forward(
        self,
        images: Tensor,
        intrinsics: Tensor,
        world_from_cam: Tensor,
        near_far: Tensor,
        patch_mask: Tensor | None = None,
    ) -> Prediction:
        """images (B, V, 3, H, W) in [0, 1], H and W multiples of 16; K (B, V, 3, 3) normalised by width and height;
        poses (B, V, 4, 4) float32, which the caller has re-centred in float64 (`service/world_frame.py`,
        `training/step.py`): an offset that stays in them costs that much precision; near_far (B, 2); patch_mask
        (B, V, P) bool, False leaves out.
        """
        batch, count, _, height, width = images.shape
        flat = images.reshape(-1, 3, height, width)
        views = Views.make(intrinsics, world_from_cam, near_far)
        keep_patch, keep_pixel = self._keep(patch_mask, flat)

        features = self.trunk(flat, count)
        semantic = self.semantic(flat)
        if self.mono is None:
            mono = flat.new_zeros(flat.shape[0], 0, height // 4, width // 4)
        else:
            mono = resize_to(self.mono_context(self.mono(flat)), features.quarter)
        estimate = self.depth(flat, features, mono, views)
        streams = {"texture": features.quarter, "semantic": semantic}
        if self.mono is not None:
            streams["depth"] = torch.cat([mono, estimate.volume, estimate.quarter, estimate.confidence], dim=1)
        tasks = self.mixture(streams, features.quarter, keep_patch)
        heads = self.heads(tasks.maps, estimate.guide)

        step = 1.0 / (self.config.depth_planes - 1)
        inverse = (estimate.full + heads.depth_step * step).clamp(-0.01, INVERSE_DEPTH_LIMIT)
        gaussians, depth = gaussians_from_heads(flat, heads, inverse, views, keep_pixel)
        if self.config.backing:
            coefficients = (self.config.sh_degree + 1) ** 2
            sheet = backing_layer(flat, inverse, views, keep_pixel, coefficients)
            gaussians = GaussianBatch.join([gaussians, sheet])
        confidence = F.interpolate(estimate.confidence, scale_factor=4, mode="bilinear", align_corners=False)
        return Prediction(
            gaussians,
            depth.reshape(batch, count, height, width),
            confidence.reshape(batch, count, height, width),
            estimate,
            inverse,
            heads,
            tasks.routing,
        )

    def _keep(self, patch_mask: Tensor | None, flat: Tensor) -> tuple[Tensor, Tensor]:
        """(B*V*P,) and (B*V, 1, H, W) factors 1 or 0."""
        rows, columns = flat.shape[-2] // PIXELS_PER_PATCH, flat.shape[-1] // PIXELS_PER_PATCH
        if patch_mask is None:
            patches = flat.new_ones(flat.shape[0], 1, rows, columns)
        else:
            patches = patch_mask.to(flat.dtype).reshape(-1, 1, rows, columns)
        pixels = F.interpolate(patches, scale_factor=PIXELS_PER_PATCH, mode="nearest")
        return patches.reshape(-1), pixels

    def keep_all(self) -> None:
        """Compute also what a scene does not need: every expert on every patch, every pair of views on every plane."""
        self.depth.sparse = False
        if self.mixture.experts is not None:
            self.mixture.experts.sparse = False

    def trainable_parameters(self) -> int:
        return sum(p.numel() for p in self.parameters() if p.requires_grad)
