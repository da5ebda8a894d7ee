"""Warn of a given depth range that misses part of the scene: photographs that match better outside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from .depth_sweep import outer_percentiles
from .given_range import CURE
from .pair_matches import PairMatches

REACH = 3.0  # depths down to near / REACH and up to far * REACH are searched
BETTER = 0.15  # of correlation, by which a match outside must beat the best one inside
# Least share of the matched contrast beyond an end for a warning. Right ranges have up to 0.007 (41 pairs of six
# captures) and 0.028 (92 generated scenes). Twice the right near has 0.055 and more in the same pairs of five captures.
LEAST = 0.04


def missed_depths(pairs: PairMatches) -> list[Notice]:
    """A warning for each end of a given range, `pairs.depths`, beyond which more than LEAST of what matches lies.

    A pixel of a pair of nearest views counts if it matches consistently in both directions in the range widened by
    REACH, at a depth outside the given one, and correlates by BETTER less with every plane inside.
    """
    depths = pairs.depths
    if depths.source != "given":
        return []
    wide = PairMatches(pairs.views, replace(depths, near=depths.near / REACH, far=depths.far * REACH))
    matched: list[NDArray[np.float64]] = []
    for pair in pairs.nearest():
        for inside, match in zip(pairs.of(*pair), wide.of(*pair), strict=True):
            gain = match.score - inside.score
            matched.append(np.stack([each.ravel()[match.good] for each in (match.depth, match.contrast, gain)]))
    depth, weight, gain = np.concatenate(matched, axis=1)
    notices: list[Notice] = []
    for end, limit, where, beyond in (
        ("near", depths.near, "nearer", depth < depths.near),
        ("far", depths.far, "farther", depth > depths.far),
    ):
        missed = beyond & (gain > BETTER)
        amount = float(weight[missed].sum())
        if amount > LEAST * weight.sum():
            low, high = outer_percentiles(depth[missed], weight[missed])
            message = (
                f"{amount / weight.sum():.0%} of what matches in the photographs lies {where} than {end} = "
                f"{limit:.4g}, at depths of {low:.4g} to {high:.4g}"
            )
            notices.append({"code": "depth_range_doubtful", "field": end, "message": f"{message} ({CURE})"})
    return notices
