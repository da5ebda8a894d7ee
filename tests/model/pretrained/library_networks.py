"""The same networks by another implementation, the transformers library's, with weights of ours.

The library is imported where it is used: importing it takes seconds, and every process of the tests collects all files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gapmes.model.backbones import DepthAnythingFeatures, VitFeatures
from gapmes.model.config import VitConfig

if TYPE_CHECKING:
    from transformers import DepthAnythingForDepthEstimation, Dinov2Config, Dinov2Model


def library_vit(features: VitFeatures) -> Dinov2Model:
    from transformers import Dinov2Model

    theirs = Dinov2Model(_config(features.config)).eval()
    theirs.load_state_dict(features.vit.state_dict(), strict=True)
    return theirs


def library_depth_anything(features: DepthAnythingFeatures) -> DepthAnythingForDepthEstimation:
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation

    shape = features.model.shape
    backbone = _config(
        features.config, out_indices=list(shape.layers), apply_layernorm=True, reshape_hidden_states=False
    )
    config = DepthAnythingConfig(
        backbone_config=backbone,
        patch_size=features.config.patch,
        reassemble_hidden_size=features.config.hidden,
        reassemble_factors=[4, 2, 1, 0.5],
        neck_hidden_sizes=list(shape.levels),
        fusion_hidden_size=shape.fusion,
        head_hidden_size=32,
        depth_estimation_type="relative",
        max_depth=1,
    )
    theirs = DepthAnythingForDepthEstimation(config).eval()
    theirs.load_state_dict(features.model.state_dict(), strict=True)
    return theirs


def _config(vit: VitConfig, **more: object) -> Dinov2Config:
    from transformers import Dinov2Config

    return Dinov2Config(
        hidden_size=vit.hidden,
        num_hidden_layers=vit.layers,
        num_attention_heads=vit.heads,
        mlp_ratio=vit.mlp_ratio,
        image_size=vit.image_size,
        patch_size=vit.patch,
        **more,
    )
