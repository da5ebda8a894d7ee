"""Which photographs foretell another one."""

import numpy as np
import pytest

from gapmes.service.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.foretold import checked_others, nearest_others


def _at(*places):
    cameras = []
    for place in places:
        pose = np.eye(4)
        pose[0, 3] = place
        cameras.append(Camera.make(64, 64, 64.0, 64.0, 32.0, 32.0, pose))
    return cameras


def test_the_nearest_cameras_in_their_own_order():
    cameras = _at(0.0, 5.0, 1.0, 2.5, 9.0)
    assert nearest_others(cameras, 0, 2) == [2, 3]
    assert nearest_others(cameras, 4, 3) == [1, 2, 3]
    assert nearest_others(cameras, 2, 5) == [0, 1, 3, 4]


def test_of_equally_near_ones_the_first():
    assert nearest_others(_at(0.0, 1.0, -1.0, 1.0), 0, 2) == [1, 2]


@pytest.mark.parametrize("count", [0, 2, 3, 4, 5])
def test_numbers_that_leave_one_of_some_set_out(count):
    assert checked_others(count) == count


@pytest.mark.parametrize("count", [1, 6, -1, True, 2.0])
def test_other_numbers_are_refused(count):
    with pytest.raises(InputError, match="need 2 to 5 views"):
        checked_others(count)
