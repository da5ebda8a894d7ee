"""Front to back: sorted by depth, ties by content, the same sequence of contents for every input order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_cases import dots

from gapmes.service.splat.order import depth_order

few = st.sampled_from([0.0, 1.0, 2.0])


@pytest.mark.case("E7")
@settings(max_examples=60)
@given(st.lists(st.tuples(few, few, few, st.booleans(), few), max_size=30), st.integers(0, 1000))
def test_order_depends_on_content_alone(rows, seed):
    table = np.array(rows, float).reshape(-1, 5)
    gaussians = dots(table[:, :3], 0.1 + 0.2 * table[:, 4], (0, 0, 0))
    depths, drawn = table[:, 2].copy(), np.flatnonzero(table[:, 3] > 0).astype(np.int32)
    order = depth_order(depths, drawn, gaussians)
    assert sorted(order) == drawn.tolist()
    assert (np.diff(depths[order]) >= 0).all()
    shuffle = np.random.default_rng(seed).permutation(len(table))
    moved = np.flatnonzero(table[shuffle, 3] > 0).astype(np.int32)
    other = depth_order(depths[shuffle], moved, gaussians[shuffle])
    assert (table[order] == table[shuffle][other]).all()
    # Within one depth: by x, then y, then opacity.
    keys = [tuple(row[[2, 0, 1, 4]]) for row in table[order]]
    assert keys == sorted(keys)


@pytest.mark.case("E16")
@settings(max_examples=40)
@given(st.integers(0, 2**32), st.sampled_from([1e-30, 1e-3, 1.0, 1e6]), st.sampled_from([1e-12, 1e-9, 1e-6, 1.0]))
def test_order_is_that_of_the_float64_depths_however_close(seed, unit, spread):
    """Depths that are equal in float32, in part or all of them, and from one to thousands."""
    rng = np.random.default_rng(seed)
    depths = unit * (1.0 + spread * rng.random(int(rng.integers(1, 3000))))
    drawn = rng.permutation(len(depths))[: max(1, len(depths) // 2)].astype(np.int32)
    order = depth_order(depths, drawn, dots(np.zeros((len(depths), 3)), np.ones(len(depths)), (0, 0, 0)))
    assert (np.diff(depths[order]) >= 0).all()
    assert sorted(order) == sorted(drawn)


@pytest.mark.case("E16")
@pytest.mark.parametrize("runs", [1, 3])
def test_runs_of_depths_that_are_equal_in_float32_are_sorted_in_their_place(runs: int) -> None:
    """A few hundred of them, longer than insertion takes, among thousands that differ, and exact ties among those."""
    rng = np.random.default_rng(runs)
    depths = rng.uniform(1.0, 9.0, 3000)
    for run in range(runs):
        depths[run * 400 : run * 400 + 300] = 2.0 + 2.0 * run + 1e-9 * rng.integers(0, 200, 300)
    rows = rng.uniform(size=(3000, 3))
    drawn = rng.permutation(3000)[:2500].astype(np.int32)
    order = depth_order(depths, drawn, dots(rows, np.ones(3000), (0, 0, 0)))
    assert sorted(order) == sorted(drawn)
    keys = [(depths[i], *rows[i]) for i in order]
    assert keys == sorted(keys)
