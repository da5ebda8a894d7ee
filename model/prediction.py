"""The prediction of any network of the contract."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from .adapter import GaussianBatch
from .routing import Routing


@dataclass(frozen=True)
class Prediction:
    """For B scenes of V views."""

    gaussians: GaussianBatch
    depth: Tensor  # (B, V, H, W) z-depth of the Gaussian of each pixel
    confidence: Tensor  # (B, V, H, W) probability of the best plane of the sweep
    routing: Routing | None  # None where nothing is routed
