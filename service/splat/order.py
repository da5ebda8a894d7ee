"""Front-to-back order by float64 depth with ties broken by content, so that renders are invariant to permutations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from .access import get, put
from .kernel_cache import kernel

DIGIT = 11  # most bits of a radix pass: 2048 counters of 8 bytes stay in the L1 cache
LONG_RUN = 64  # depths equal in float32 above which insertion sort, which is quadratic, would be slow
SORTED, TIED, UNSORTED = 0, 1, 2


def depth_order(depths: NDArray[np.float64], drawn: NDArray[np.int32], gaussians: Gaussians) -> NDArray[np.int32]:
    """Indices `drawn` (M,) of Gaussians with positive `depths` (N,), sorted nearest first.

    A radix sort by the bits of the float32 depths, which compare like integers where positive, followed by a float64
    sort of runs that are equal in float32. Ties are broken by mean, then scales, rotation, opacity and harmonics;
    Gaussians equal in all of these are interchangeable.
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
    """Both sorted by the keys, stably. The arrays given are used as buffers."""
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
    """Insertion-sort each run of equal `keys` in `order` by float64 depth, in place.

    Returns TIED if any depths are equal, UNSORTED if it stopped at a run of more than LONG_RUN, else SORTED. `order` is
    sorted by the keys, the depths rounded to float32."""
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
    """Stable counting sort by the `bits` of keys - least that begin at `shift`; `starts` (2^bits,) is a buffer."""
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
    """Sort runs of equal depth by content, in place."""
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
    """Positions that belong to a run of two or more equal values, from whether each equals its successor."""
    member = np.zeros(len(equal_to_next) + 1, bool)
    member[:-1] |= equal_to_next
    member[1:] |= equal_to_next
    return np.flatnonzero(member)
