"""Front-to-back order: by float64 depth, ties by content, so that no permutation of the input changes a bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from .access import get, put
from .kernel_cache import kernel

DIGIT = 11  # bits of a radix pass at most: 2048 counters of 8 bytes stay in the first-level cache
LONG_RUN = 64  # depths that are equal in float32: from here on sorting by insertion would be slow
SORTED, TIED, UNSORTED = 0, 1, 2


def depth_order(depths: NDArray[np.float64], drawn: NDArray[np.int32], gaussians: Gaussians) -> NDArray[np.int32]:
    """Indices of the drawn Gaussians (M,), nearest first; their depths are positive.

    A radix sort by the bits of the depths rounded to float32, which keep the order of positive numbers, then what is
    equal in these. Equal depths are ordered by mean, then by scales, rotation, opacity and harmonics; what is equal in
    all of these is interchangeable.
    """
    if not len(drawn):
        return drawn
    depths = np.require(depths, requirements=["C", "W"])
    narrow = depths[drawn].astype(np.float32)
    keys, order = radix_sorted(narrow.view(np.uint32), drawn.copy())
    state = settle_equals(keys, depths, order)
    if state == UNSORTED:
        runs = _in_runs(keys[1:] == keys[:-1])
        rows = order[runs]
        order[runs] = rows[np.argsort(depths[rows])]  # each run keeps its place
    if state != SORTED:
        _order_ties(depths, order, gaussians)
    return order


def radix_sorted(keys: NDArray[np.uint32], values: NDArray[np.int32]) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
    """Both in the order of the keys, equal ones in the order they had. The arrays given are used as room to sort in."""
    least = keys.min()
    bits = max(1, int(keys.max() - least).bit_length())
    passes = -(-bits // DIGIT)
    digit = -(-bits // passes)
    starts = np.empty(1 << digit, np.int64)
    other_keys, other_values = np.empty_like(keys), np.empty_like(values)
    for turn in range(passes):
        radix_pass(keys, values, other_keys, other_values, starts, least, np.uint32(turn * digit))
        keys, other_keys, values, other_values = other_keys, keys, other_values, values
    return keys, values


@kernel()
def settle_equals(keys, depths, order):
    """Sort each run of equal `keys` by depth, by insertion; returns TIED if any depths are equal, UNSORTED if a run is
    so long that it gave up. `order` is sorted by the keys, which are the depths rounded."""
    state, begin = SORTED, 0
    for p in range(1, keys.size):
        if get(keys, p) != get(keys, p - 1):
            begin = p
            continue
        if p - begin == LONG_RUN:
            return UNSORTED
        value, q = get(order, p), p
        depth = get(depths, value)
        while q > begin and get(depths, get(order, q - 1)) > depth:
            put(order, q, get(order, q - 1))
            q -= 1
        put(order, q, value)
        if q > begin and get(depths, get(order, q - 1)) == depth:
            state = TIED
    return state


@kernel()
def radix_pass(keys, values, sorted_keys, sorted_values, starts, least, shift):
    """Stable counting sort by the bits of keys - least from `shift` on, as many as `starts` (2^bits,) has room for."""
    mask = np.uint32(starts.size - 1)
    for d in range(starts.size):
        put(starts, d, 0)
    for p in range(keys.size):
        digits = np.int64(((get(keys, p) - least) >> shift) & mask)
        put(starts, digits, get(starts, digits) + 1)
    total = 0
    for d in range(starts.size):
        here = get(starts, d)
        put(starts, d, total)
        total += here
    for p in range(keys.size):
        key = get(keys, p)
        digits = np.int64(((key - least) >> shift) & mask)
        to = get(starts, digits)
        put(starts, digits, to + 1)
        put(sorted_keys, to, key)
        put(sorted_values, to, get(values, p))


def _order_ties(depths: NDArray[np.float64], order: NDArray[np.int32], gaussians: Gaussians) -> None:
    """Put runs of equal depth in the order of their content, in place."""
    sorted_depths = depths[order]
    tied = _in_runs(sorted_depths[1:] == sorted_depths[:-1])
    if not len(tied):
        return
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


def _in_runs(equal_to_next: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Positions that belong to a run of equal values, given whether each position equals its successor."""
    member = np.zeros(len(equal_to_next) + 1, bool)
    member[:-1] |= equal_to_next
    member[1:] |= equal_to_next
    return np.flatnonzero(member)
