"""Front to back: sorted by depth, ties by content, the same sequence of contents for every input order."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_cases import dots

from gapmes.service.splat.order import depth_order

few = st.sampled_from([0.0, 1.0, 2.0])


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(few, few, few, st.booleans(), few), max_size=30), st.integers(0, 1000))
def test_order_depends_on_content_alone(rows, seed):
    table = np.array(rows, float).reshape(-1, 5)
    gaussians = dots(table[:, :3], 0.1 + 0.2 * table[:, 4], (0, 0, 0))
    depths, drawn = table[:, 2].copy(), table[:, 3] > 0
    order = depth_order(depths, drawn, gaussians)
    assert sorted(order) == np.flatnonzero(drawn).tolist()
    assert (np.diff(depths[order]) >= 0).all()
    shuffle = np.random.default_rng(seed).permutation(len(table))
    other = depth_order(depths[shuffle], drawn[shuffle], gaussians[shuffle])
    assert (table[order] == table[shuffle][other]).all()
    # Within one depth: by x, then y, then opacity.
    keys = [tuple(row[[2, 0, 1, 4]]) for row in table[order]]
    assert keys == sorted(keys)
