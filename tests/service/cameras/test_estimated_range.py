"""Ends of depth ranges: of those that are given, of files, and of estimates that are cut to what two views share."""

import math

import numpy as np
import pytest
from test_depth_range import arc, look_at, side_by_side

from gapmes.service.cameras.camera_fields import CameraFile
from gapmes.service.cameras.depth_range import convergence_depths, depth_range
from gapmes.service.cameras.rotations import about_axis


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


def test_a_walk_straight_ahead_begins_at_two_fifths_of_its_length() -> None:
    (first,), ahead = side_by_side(1), np.eye(4)
    ahead[2, 3] = 0.5
    estimate = depth_range([first, first.posed(ahead)])
    assert (estimate.near, estimate.far) == (pytest.approx(0.4 * 0.5), pytest.approx(50 * 0.5))


@pytest.mark.parametrize(("degrees", "share"), [(0.0, 0.5), (4.9, 0.5), (5.1, 0.4), (9.0, 0.4)])
def test_cameras_count_as_side_by_side_up_to_five_degrees(degrees: float, share: float) -> None:
    """Turned away from each other, through a lens so wide that they share enough at near."""
    turns = [about_axis(np.array([0.0, 1.0, 0.0]), math.radians(sign * degrees / 2)) for sign in (-1, 1)]
    pair = side_by_side(2, step=1.0, focal=10)
    for camera, turn in zip(pair, turns, strict=True):
        camera.world_from_cam[:3, :3] = turn
    assert convergence_depths(pair) is None
    assert depth_range(pair).near == pytest.approx(share)


@pytest.mark.parametrize(("degrees", "meet"), [(1.9, False), (2.1, True)])
def test_axes_meet_from_two_degrees_on(degrees: float, meet: bool) -> None:
    half = math.radians(degrees / 2)
    assert (convergence_depths(arc([-half, half])) is not None) == meet


def test_one_axis_that_misses_where_the_others_meet_is_enough_for_none() -> None:
    """The third looks up past the point by a fifth of its distance."""
    cameras = arc([-0.3, 0.3, 0.0])
    assert convergence_depths(cameras) is not None
    pose = cameras[2].world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([1.0, 0.0, 0.0]), 0.2)
    assert convergence_depths([*cameras[:2], cameras[2].posed(pose)]) is None


@pytest.mark.parametrize("focal", np.geomspace(60, 1250, 60).tolist())
def test_an_estimate_has_two_ends_however_narrow_the_lens(focal: float) -> None:
    """Across a corner two narrow lenses share a tenth at one of the depths that are tried, or at none."""
    estimate = depth_range([look_at(one.center, (1.0, 2.0, 3.0), focal=focal) for one in arc([0.0, 1.4], 6.0)])
    assert estimate.near < 6.0 < estimate.far
