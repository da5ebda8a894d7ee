"""Depth of every pixel from CNN, multi-view and ViT features: one or two scales of matching, then fine detail."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..cost_volume import Views
from ..layers import softmax_of_channels
from ..normalisation import GroupNorm
from ..vit import normalised_for_vit
from .cnn import CnnEncoder
from .config import CNN_CHANNELS, DEPTH_HEAD, FEATURES, PLANES, VITS, DepthSplatConfig
from .dpt import DptHead, replicate_conv
from .neighbours import nearest_views, neighbour_rows
from .pyramid import FeaturePyramid
from .sweep import plane_sweep
from .transformer import MultiViewTransformer, with_positions
from .unet import GROUPS, UNet
from .vit import IntermediateVit

UNET_LEVELS = 3  # of the first scale; one more at the second


@dataclass(frozen=True)
class MatchedDepth:
    """What one pass over n = B * V views yields."""

    inverse: Tensor  # (n, 1, H, W) 1 / z, within the range
    probability: Tensor  # (n, D, h, w) of the candidates at the finest matched resolution
    cnn: tuple[Tensor, Tensor, Tensor]
    vit: list[Tensor]
    multi_view: list[Tensor]  # coarse to fine


class MultiViewDepth(nn.Module):
    """The trunk: its submodules carry the names of the published layout."""

    def __init__(self, config: DepthSplatConfig) -> None:
        super().__init__()
        self.config = config
        hidden = VITS[config.vit].hidden
        self.backbone = CnnEncoder(config.coarsest)
        self.transformer = MultiViewTransformer()
        self.pretrained = IntermediateVit(config.vit)
        self.mv_pyramid = FeaturePyramid(FEATURES) if config.scales == 2 else None
        self.mono_pyramid = FeaturePyramid(hidden) if config.scales == 2 else None
        self.regressor, self.regressor_residual = nn.ModuleList(), nn.ModuleList()
        self.depth_head = nn.ModuleList()
        for scale in range(config.scales):
            planes, width = PLANES // 4**scale, FEATURES // 2**scale
            texture = CNN_CHANNELS[2 - scale]
            inputs = planes + texture + width + hidden // 2**scale
            self.regressor.append(
                nn.ModuleList(
                    [
                        nn.Conv2d(inputs, width, 3, padding=1),
                        GroupNorm(GROUPS, width),
                        nn.GELU(),
                        UNet(width, UNET_LEVELS + scale),
                        nn.Conv2d(width, width, 3, padding=1),
                    ]
                )
            )
            self.regressor_residual.append(nn.Conv2d(inputs, width, 1))
            self.depth_head.append(
                nn.Sequential(replicate_conv(width, 2 * width), nn.GELU(), replicate_conv(2 * width, planes))
            )
        self.upsampler = DptHead(config, DEPTH_HEAD[config.vit], depth=True)

    def forward(self, images: Tensor, views: Views) -> MatchedDepth:
        """images (n, 3, H, W) in [0, 1]."""
        compatibility = self.config.compatibility
        normalised = normalised_for_vit(images)
        cnn = self.backbone(normalised)
        neighbours = nearest_views(views.world_from_cam, as_listed=compatibility.tiled_mask)
        coarse = self.transformer(
            with_positions(cnn[2]), neighbour_rows(neighbours), tiled_mask=compatibility.tiled_mask
        )
        multi_view = [coarse] if self.mv_pyramid is None else self.mv_pyramid(coarse)
        vit = self.pretrained(normalised)
        last = vit[-1]  # at 1/8 resolution
        if self.config.coarsest == 4:
            last = F.interpolate(last, scale_factor=2.0, mode="bilinear", align_corners=True)
        mono = [last] if self.mono_pyramid is None else self.mono_pyramid(last)

        low, high = views.per_view(views.inverse_far), views.per_view(views.inverse_near)
        depth: Tensor | None = None
        for scale in range(self.config.scales):
            planes = PLANES // 4**scale
            candidates = _candidates(depth, low, high, planes)
            volume = plane_sweep(multi_view[scale], candidates, views, neighbours, compatibility)
            joined = torch.cat([volume, cnn[2 - scale], multi_view[scale], mono[scale]], dim=1)
            probability = softmax_of_channels(self.depth_head[scale](self._regressed(scale, joined, views.count)))
            depth = (probability * candidates).sum(1, keepdim=True)
        assert depth is not None
        detail = self.upsampler(vit, cnn, multi_view, depth)
        factor = float(self.config.upsample_factor)
        full = F.interpolate(depth, scale_factor=factor, mode="bilinear", align_corners=True) + detail
        return MatchedDepth(torch.minimum(torch.maximum(full, low), high), probability, cnn, vit, multi_view)

    def _regressed(self, scale: int, joined: Tensor, views: int) -> Tensor:
        first, norm, activation, unet, last = self.regressor[scale].children()
        return last(unet(activation(norm(first(joined))), views)) + self.regressor_residual[scale](joined)


def _candidates(depth: Tensor | None, low: Tensor, high: Tensor, planes: int) -> Tensor:
    """Inverse depths (n, D, 1, 1) over the whole range, or (n, D, h, w) around the depth of the coarser scale.

    The second scale's reach D / 2 intervals of half the first scale's, cut off at the ends of the range.
    """
    steps = torch.linspace(0, 1, planes, device=low.device).reshape(1, planes, 1, 1)
    if depth is None:
        return low + steps * (high - low)
    centre = F.interpolate(depth, scale_factor=2.0, mode="bilinear", align_corners=True).detach()
    interval = (high - low) / (PLANES - 1) / 2
    first = torch.maximum(centre - interval * (planes // 2), low)
    last = torch.minimum(centre + interval * (planes // 2 - 1), high)
    return first + steps * (last - first)
