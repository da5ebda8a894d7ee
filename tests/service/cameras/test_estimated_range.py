"""Ends of depth ranges: of those that are given, of files, and of estimates that are cut to what two views share."""

import numpy as np
import pytest
from test_depth_range import side_by_side

from gapmes.service.cameras.camera_fields import CameraFile
from gapmes.service.cameras.depth_range import depth_range


@pytest.mark.parametrize(("near", "far"), [(1.01e-32, 1e-10), (1e20, 9.9e31), (1.0, 9.9e29), (1.0, 1.0000011)])
def test_a_range_up_to_the_ends_is_taken(near: float, far: float) -> None:
    given = depth_range(side_by_side(), near, far)
    assert (given.near, given.far) == (near, far)


def test_each_end_that_is_given_wins_over_that_of_the_file() -> None:
    file = CameraFile((), 1.0, 9.0)
    assert [file.depths(*given) for given in ((None, None), (2.0, None), (None, 5.0), (2.0, 5.0))] == [
        (1.0, 9.0),
        (2.0, 9.0),
        (1.0, 5.0),
        (2.0, 5.0),
    ]


def test_an_estimate_begins_where_one_pair_shares_a_tenth() -> None:
    """A third view looks back: axes that meet nowhere, from 0.4 baselines on; at 1.04 the pair shares a tenth."""
    pair = side_by_side(2, step=1.0)
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    estimate = depth_range([*pair, pair[0].posed(back)])
    assert 1.0 < estimate.near < 1.45  # one of 24 steps, and a twelfth of the picture
    assert estimate.far == pytest.approx(50)
