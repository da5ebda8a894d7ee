"""The GaPMeS network: posed images to 3D Gaussians, with the routing that made them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .adapter import GaussianBatch, gaussians_from_heads
from .backbones import DepthAnythingFeatures, VitFeatures
from .backing import backing_layer
from .config import ModelConfig
from .cost_volume import Views
from .depth import DepthEstimate, DepthFromMatching
from .full_trunk import FullTrunk
from .heads import HeadOutputs, Heads
from .layers import resize_to
from .masking import kept
from .prediction import Prediction
from .routing import Gates
from .streams import PatchMixture
from .trunk import LightTrunk

INVERSE_DEPTH_LIMIT = 1.3  # normalised; a little nearer than `near` is allowed, the far end is clamped at 0


@dataclass(frozen=True)
class FullPrediction(Prediction):
    """Also what the losses read."""

    estimate: DepthEstimate  # normalised inverse depths, for the depth losses
    final_inverse: Tensor  # (B*V, 1, H, W) normalised inverse depth after the head's correction
    heads: HeadOutputs


class GaPMeS(nn.Module):
    """Feed-forward Gaussian splatting with patch-level mixture of experts."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        self.provenance: dict[str, str] = {}  # metadata of its checkpoints: where frozen parts came from
        self.trunk = FullTrunk(config) if config.trunk == "full" else LightTrunk(config)
        self.semantic = VitFeatures(config.semantic_vit, frozen=config.freeze_vits)
        self.mono = None if config.without_depth else _mono(config)
        mono = 0
        if self.mono is not None:
            self.mono_context = nn.Conv2d(config.depth_vit.hidden, config.stream_channels, 1)
            mono = config.stream_channels + int(config.depth_head)
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
    ) -> FullPrediction:
        """images (B, V, 3, H, W) in [0, 1], H and W multiples of 16; K (B, V, 3, 3) normalised by width and height;
        poses (B, V, 4, 4) float32, which the caller has re-centred in float64 (`service/cameras/world_frame.py`,
        `training/step.py`): an offset that stays in them costs that much precision; near_far (B, 2); patch_mask
        (B, V, P) bool, False leaves out.
        """
        batch, count, _, height, width = images.shape
        flat = images.reshape(-1, 3, height, width)
        views = Views.make(intrinsics, world_from_cam, near_far)
        keep_patch, keep_pixel = kept(patch_mask, flat)

        features = self.trunk(flat, views)
        semantic = self.semantic(flat)
        mono = self._mono_cues(flat, features.quarter)
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
        return FullPrediction(
            gaussians,
            depth.reshape(batch, count, height, width),
            confidence.reshape(batch, count, height, width),
            tasks.routing,
            estimate,
            inverse,
            heads,
        )

    @property
    def gates(self) -> Gates | None:
        return self.mixture.gates

    def _mono_cues(self, images: Tensor, like: Tensor) -> Tensor:
        """(n, mono, H/4, W/4), no channel without the depth stream."""
        if self.mono is None:
            return like[:, :0]
        if isinstance(self.mono, DepthAnythingFeatures):
            tokens, inverse = self.mono(images)
            return torch.cat([resize_to(self.mono_context(tokens), like), inverse], dim=1)
        return resize_to(self.mono_context(self.mono(images)), like)

    def keep_all(self) -> None:
        """Compute also what a scene does not need: every expert on every patch, every pair of views on every plane."""
        self.depth.sparse = False
        if self.mixture.experts is not None:
            self.mixture.experts.sparse = False

    def trainable_parameters(self) -> int:
        return sum(p.numel() for p in self.parameters() if p.requires_grad)


def _mono(config: ModelConfig) -> VitFeatures | DepthAnythingFeatures:
    kind = DepthAnythingFeatures if config.depth_head else VitFeatures
    return kind(config.depth_vit, frozen=config.freeze_vits)
