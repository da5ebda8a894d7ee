"""Variants of a checkpoint's network for export: architecture, experts per patch, dense or sparse computation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from gapmes.model.architectures import Loaded, NetworkConfig, load_network
from gapmes.model.config import ModelConfig
from gapmes.model.depthsplat.config import PLAIN, Compatibility, DepthSplatConfig
from gapmes.model.depthsplat.network import DepthSplat


@dataclass(frozen=True)
class Variant:
    """Settings of an export beside the checkpoint's own configuration."""

    top_k: int | None = None  # experts per patch, of those it was trained with
    keep_all: bool = False  # every expert on every patch, every pair of views on every plane
    architecture: str = "gapmes"
    compatibility: Compatibility = PLAIN  # of DepthSplat
    scale_max: float | None = None  # of DepthSplat's Gaussians, in its units; None: as published

    @staticmethod
    def of(config: NetworkConfig) -> Variant:
        """The variant that an exported file's configuration describes, without `keep_all`, which changes no result."""
        if isinstance(config, DepthSplatConfig):
            return Variant(architecture="depthsplat", compatibility=config.compatibility, scale_max=config.scale_max)
        return Variant(None if config.without_experts else config.top_k)


def load_variant(checkpoint: Path, variant: Variant) -> Loaded:
    """The checkpoint's network with the variant's settings.

    Raises `CheckpointError`, and `ValueError` for a wrong `top_k`.
    """
    loaded = load_network(checkpoint, variant.architecture, variant.compatibility, variant.scale_max)
    network = loaded.network
    if isinstance(network, DepthSplat):
        if variant.top_k is not None or variant.keep_all:
            raise ValueError("DepthSplat has no experts: top_k and keep_all are settings of gapmes networks")
        return loaded
    if variant.top_k is not None:
        network.config = with_top_k(network.config, variant.top_k)
        if network.mixture.gates is not None:
            network.mixture.gates.top_k = variant.top_k
    if variant.keep_all:
        network.keep_all()
    return loaded


def with_top_k(config: ModelConfig, top_k: int) -> ModelConfig:
    """The configuration with another number of experts per patch. Raises `ValueError`."""
    if config.without_experts:
        raise ValueError(f"top_k is {top_k}, but the network has no experts")
    return replace(config, top_k=top_k)
