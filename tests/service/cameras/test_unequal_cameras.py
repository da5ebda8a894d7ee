"""Cameras of which no two numbers are equal: turned ones, oblong pixels, unequal lenses, baselines across and along."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.leave_one_out import nearest_others
from gapmes.service.cameras.overlap import best_partner_shares
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.view_checks import check_views
from gapmes.service.errors import OverlapError

UP = np.array([0.0, 1.0, 0.0])
RANGE = DepthRange(3.0, 12.0, "given")


def pose(center: object, turn: float = 0.0, world: np.ndarray | None = None) -> np.ndarray:
    """Turned by radians about the vertical at `center`, in a turned `world`."""
    world = np.eye(3) if world is None else world
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = world @ about_axis(UP, turn), world @ np.asarray(center, np.float64)
    return found


def looking(center: object, turn: float = 0.0, focal: float = 64.0, world: np.ndarray | None = None) -> Camera:
    return Camera.make(64, 64, focal, focal, 32, 32, pose(center, turn, world))


def test_the_nearest_are_counted_in_the_axes_of_the_camera_itself() -> None:
    """It looks along x: what lies along z is beside it, what moves along its own axis hardly parts its rays."""
    cameras = [looking((0, 0, 0), np.pi / 2), looking((0, 0, 1)), looking((0, 0, -1)), looking((0, 0, 0.5))]
    assert nearest_others(cameras, 0, 2, 2.0) == [1, 3]


@pytest.mark.parametrize("world", [np.eye(3), np.diag([-1.0, 1.0, -1.0])])
def test_the_nearest_do_not_depend_on_the_axes_of_the_world(world: np.ndarray) -> None:
    places = ((0, 0), (1, 0.3), (1, -0.3), (5, 0))
    cameras = [looking((x, 0, 0), turn, world=world) for x, turn in places]
    assert nearest_others(cameras, 0, 2, 2.0) == [2, 3]


def test_a_baseline_across_and_along_counts_both() -> None:
    cameras = [looking((0, 0, 0), focal=15.0), looking((0.3, 0, 0.4), focal=15.0)]
    found = depth_range(cameras)
    assert (found.near, found.far) == (pytest.approx(0.31), pytest.approx(25.0))


def test_a_wide_and_a_narrow_lens_share_what_either_sees() -> None:
    """The narrow one's whole picture is a sixteenth of the wide one's: the mean of both is shared."""
    cameras = [looking((0, 0, 0), focal=32.0), looking((1e-3, 0, 0), focal=128.0)]
    found = best_partner_shares(cameras, [1e6])
    np.testing.assert_allclose(found, (1 + 1 / 16) / 2)


def test_pixels_that_are_oblong_move_by_the_longer_focal_length() -> None:
    """0.0126 to the side is 0.25 px at depth 3 with 60 px; with 30 px it were refused."""
    cameras = [Camera.make(64, 48, 60.0, 30.0, 32, 24, pose((x, 0, 0))) for x in (0, 0.0126)]
    assert check_views(cameras, RANGE) == []


def test_tiny_units_are_no_common_place() -> None:
    cameras = [looking((x, 0, 0)) for x in (0, 1e-7, 2e-7)]
    assert check_views(cameras, DepthRange(3e-6, 12e-6, "given")) == []


def test_a_principal_point_near_the_border_of_a_low_picture_is_one() -> None:
    """Of 64 x 8 px: half a pixel is a sixteenth of the height, where higher pictures have normalised intrinsics."""
    cameras = [Camera.make(64, 8, 60.0, 8.0, 0.5, 0.5, pose((x, 0, 0))) for x in (0, 0.3)]
    assert check_views(cameras, RANGE, trust_poses=True) == []


def facing_away(angles: tuple[float, ...]) -> list[Camera]:
    """Cameras on a circle about (0, 0, 6), in OpenGL's axes, so that they look away from it."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    centers = [(6 * np.sin(a), 0, 6 * (1 - np.cos(a))) for a in angles]
    return [
        Camera.make(64, 48, 60.0, 60.0, 32, 24, pose(center, -angle) @ flip)
        for center, angle in zip(centers, angles, strict=True)
    ]


def test_the_view_that_overlaps_no_other_is_named_as_the_caller_does() -> None:
    with pytest.raises(OverlapError, match="view 4") as caught:
        check_views(facing_away((-0.55, 0.55)), RANGE, numbers=(4, 7))
    assert caught.value.index == 4


def test_a_reading_that_leaves_a_view_without_overlap_is_no_cure() -> None:
    """The first two are in OpenGL's axes, the third looks elsewhere however they are read."""
    cameras = facing_away((-0.55, 0.55))
    assert "look like" in _cure(cameras)
    assert "look like" not in _cure([*cameras, cameras[0].posed(pose((0, 50, 0)))])


def _cure(cameras: list[Camera]) -> str:
    with pytest.raises(OverlapError) as caught:
        check_views(cameras, RANGE)
    return str(caught.value.cure)
