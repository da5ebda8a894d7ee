"""Numbers of the published network that no tensor of its files holds, and no comparison of two runtimes can tell."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gapmes.model.cost_volume import Views
from gapmes.model.depthsplat.adapter import COEFFICIENTS, RAW_CHANNELS, gaussians_from_raw
from gapmes.model.depthsplat.config import DepthSplatConfig
from gapmes.model.depthsplat.depth import PLANES, _candidates


def test_bands_of_harmonics_are_a_quarter_of_those_below_from_a_tenth_on() -> None:
    """Colour and rotations keep their norms: raw ones of 1 have a norm of the root of 2 l + 1, times 0.1 / 4^l."""
    eye = torch.eye(4).expand(1, 2, 4, 4)
    views = Views.make(torch.eye(3).expand(1, 2, 3, 3), eye, torch.tensor([[1.0, 9.0]]))
    raw = torch.zeros(2, RAW_CHANNELS, 4, 4)
    raw[:, -3 * COEFFICIENTS :] = 1.0
    grey, ones = torch.full((2, 3, 4, 4), 0.5), torch.ones(2, 1, 4, 4)
    found = gaussians_from_raw(grey, raw, ones, views, ones, DepthSplatConfig("small", 1)).harmonics
    for band in range(int(np.sqrt(COEFFICIENTS))):
        norm = found[0, 0, band**2 : (band + 1) ** 2].norm(dim=0).numpy()
        gain = 1.0 if band == 0 else 0.1 * 0.25**band
        np.testing.assert_allclose(norm, gain * np.sqrt(2 * band + 1), rtol=1e-5)


@pytest.mark.parametrize("planes", [64, 32])
def test_the_second_scale_has_its_candidates_half_a_step_apart_about_the_first_ones_depth(planes: int) -> None:
    low, high = torch.full((1, 1, 1, 1), 0.1), torch.full((1, 1, 1, 1), 2.0)
    depth = torch.full((1, 1, 2, 2), 1.05)
    found = _candidates(depth, low, high, planes)[0, :, 0, 0]
    step = 1.9 / (PLANES - 1) / 2
    np.testing.assert_allclose(found.diff().numpy(), step, rtol=1e-3)
    assert found[planes // 2] == pytest.approx(1.05, rel=1e-6)
