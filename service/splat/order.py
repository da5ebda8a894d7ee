"""Front-to-back order: by float64 depth, ties by content, so that no permutation of the input changes a bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians


def depth_order(depths: NDArray[np.float64], drawn: NDArray[np.bool_], gaussians: Gaussians) -> NDArray[np.int64]:
    """Indices of the drawn Gaussians (M,), nearest first.

    Equal depths are ordered by mean, then by scales, rotation, opacity and harmonics; what is equal in all of these is
    interchangeable.
    """
    index = np.flatnonzero(drawn)
    order = index[np.argsort(depths[index])]
    sorted_depths = depths[order]
    tied = _in_runs(sorted_depths[1:] == sorted_depths[:-1])
    if not len(tied):
        return order
    # Sorting by depth again inside the tied positions keeps each run in its place.
    rows = order[tied]
    rows = rows[np.lexsort((*gaussians.means[rows].T[::-1], depths[rows]))]
    keys = np.column_stack([depths[rows], gaussians.means[rows]])
    twins = _in_runs((keys[1:] == keys[:-1]).all(axis=1))
    if len(twins):
        some = rows[twins]
        content = np.concatenate(
            [
                depths[some, None],
                gaussians.means[some],
                gaussians.scales[some],
                gaussians.rotations_wxyz[some],
                gaussians.opacities[some, None],
                gaussians.harmonics[some].reshape(len(some), -1),
            ],
            axis=1,
        )
        rows[twins] = some[np.lexsort(content.T[::-1])]
    order[tied] = rows
    return order


def _in_runs(equal_to_next: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Positions that belong to a run of equal values, given whether each position equals its successor."""
    member = np.zeros(len(equal_to_next) + 1, bool)
    member[:-1] |= equal_to_next
    member[1:] |= equal_to_next
    return np.flatnonzero(member)
