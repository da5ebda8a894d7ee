"""DepthSplat with a ViT small enough for tests; all else is as in the published networks."""

from __future__ import annotations

import pytest
from full_networks import VIT
from random_checkpoint import randomised

from gapmes.model.depthsplat import config as sizes
from gapmes.model.depthsplat.network import DepthSplat


def miniature_depthsplat(scales: int, coarsest: int, compatibility: sizes.Compatibility = sizes.PLAIN) -> DepthSplat:
    """Random weights, in evaluation mode."""
    with pytest.MonkeyPatch.context() as patch:
        for table, value in (
            (sizes.VITS, VIT),
            (sizes.TAPS, (1, 2, 3, 4)),
            (sizes.DEPTH_HEAD, 8),
            (sizes.FEATURE_HEAD, 16),
            (sizes.HEAD_WIDTHS, (8, 16, 32, 48)),
        ):
            patch.setitem(table, "miniature", value)  # type: ignore[index]
        return randomised(DepthSplat(sizes.DepthSplatConfig("miniature", scales, compatibility, coarsest)))
