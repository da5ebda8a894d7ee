"""Matches between the photographs of the sample scene, at the network's size."""

from __future__ import annotations

from collections.abc import Sequence

from sample_photographs import FAR, NEAR, sample_views

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.matching.pair_matches import PairMatches


def sample(which: Sequence[int] = (1, 3)) -> PairMatches:
    """The matches of the views with these indices."""
    return PairMatches(sample_views(which), DepthRange(NEAR, FAR, "given"))
