"""Distances of matches from their lines for cameras with random changes, and noise beside them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gapmes.service.matching.epipolar import CHANGES
from gapmes.service.matching.pose_changes import PoseChanges

MATCHES = 150  # of each pair
ALIKE = 0.1  # of the slopes of a pair's cameras: by how much they differ but for the sign


def pose_changes(
    views: int, wrong: tuple[int, ...], *, noise: float = 0.15, change: float = 4e-3
) -> tuple[PoseChanges, NDArray[np.float64]]:
    """Distances of all pairs of `views` that are off by normal `noise`, in px, and by the changes (V, CHANGES) that
    mend the cameras `wrong`, normal deviates times `change`; and these changes."""
    random, pairs = np.random.default_rng(5), list(combinations(range(views), 2))
    slopes = np.zeros((MATCHES * len(pairs), views, CHANGES))
    for row, (one, other) in enumerate(pairs):
        part = slice(MATCHES * row, MATCHES * (row + 1))
        slopes[part, one] = 300 * random.normal(size=(MATCHES, CHANGES))
        slopes[part, other] = 300 * ALIKE * random.normal(size=(MATCHES, CHANGES)) - slopes[part, one]
    changes = np.zeros((views, CHANGES))
    changes[list(wrong)] = random.normal(scale=change, size=(len(wrong), CHANGES))
    px = random.normal(scale=noise, size=len(slopes)) - np.einsum("nvc,vc->n", slopes, changes)
    return PoseChanges(px, slopes, [0] * views), changes
