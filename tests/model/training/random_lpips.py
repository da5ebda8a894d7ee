"""Random LPIPS weights, for tests that need a distance but not its value."""

from __future__ import annotations

import torch

from gapmes.model.training.lpips import LAYERS


def random_weights() -> dict[str, torch.Tensor]:
    """Of the right shapes; the linear layers are positive, as those of LPIPS are."""
    generator = torch.Generator().manual_seed(3)
    weights = {}
    for i, ((out, channels, kernel), _, _) in enumerate(LAYERS):
        spread = (channels * kernel**2) ** -0.5
        weights[f"net.{i}.weight"] = spread * torch.randn(out, channels, kernel, kernel, generator=generator)
        weights[f"net.{i}.bias"] = 0.1 * torch.randn(out, generator=generator)
        weights[f"NetLinLayer_{i}.0.weight"] = torch.rand(1, out, 1, 1, generator=generator)
    return weights
