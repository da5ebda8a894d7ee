"""Checks of the cameras alone: plausible sets pass without a warning, each mistake is refused by name."""

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.pose import rigid_inverse
from gapmes.service.cameras.pose_readings import other_readings
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.view_checks import check_count, check_views, range_notices
from gapmes.service.errors import BaselineError, IntrinsicsError, OverlapError, ViewCountError

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
UP = np.array([0.0, 1.0, 0.0])


def ring(angles, distance=6.0, focal=60.0):
    """Cameras on a circle about (0, 0, distance) that look at it; angle 0 is the world's origin."""
    cameras = []
    for angle in angles:
        pose = np.eye(4)
        pose[:3, :3] = about_axis(UP, -angle)
        pose[:3, 3] = [distance * np.sin(angle), 0.0, distance * (1 - np.cos(angle))]
        cameras.append(Camera.make(64, 48, focal, focal, 32, 24, pose))
    return cameras


def given(near=3.0, far=12.0):
    return DepthRange(near, far, "given")


@pytest.mark.parametrize("angles", [(0, 0.3), (0, 0.05), (-0.4, 0, 0.4), (0, 0.1, 0.2, 0.3, 0.4, 0.5)])
def test_plausible_cameras_pass_without_a_word(angles):
    cameras = ring(angles)
    assert check_views(cameras, given()) == []
    assert check_views(cameras, depth_range(cameras)) == []


@pytest.mark.parametrize(("count", "said"), [(0, "0 views"), (1, "1 view"), (7, "7 views")])
def test_the_number_of_views(count, said):
    with pytest.raises(ViewCountError, match=f"{said}, need 2 to 6"):
        check_count(count)
    with pytest.raises(ViewCountError):
        check_views(ring([0.1 * i for i in range(count)]), given())


@pytest.mark.case("P2")
def test_the_same_view_twice_is_named():
    cameras = ring((0, 0.2, 0.4))
    with pytest.raises(BaselineError, match="views 0 and 3 have the same pose") as caught:
        check_views([*cameras, cameras[0]], given())
    assert caught.value.index == 3


@pytest.mark.case("P2")
def test_pure_rotation_has_no_parallax():
    cameras = ring((0,))
    turned = cameras[0].world_from_cam.copy()
    turned[:3, :3] = about_axis(UP, 0.2)
    with pytest.raises(BaselineError, match=r"no pair of views has parallax: the widest, views 0 and 1") as caught:
        check_views([*cameras, cameras[0].posed(turned)], given())
    assert "same unit" in caught.value.cure


@pytest.mark.case("P2")
@pytest.mark.parametrize(
    ("baseline", "passes"), [(1e-6, False), (1e-4, False), (1e-3, False), (0.01249, False), (0.01251, True)]
)
def test_the_parallax_threshold_is_a_quarter_of_a_pixel_at_near(baseline, passes):
    """f b / near = 60 * 0.0125 / 3 = 0.25 px."""
    cameras = ring((0,))
    moved = cameras[0].world_from_cam.copy()
    moved[0, 3] += baseline
    cameras.append(cameras[0].posed(moved))
    if passes:
        check_views(cameras, given())
    else:
        with pytest.raises(BaselineError):
            check_views(cameras, given())


@pytest.mark.parametrize("times", [1e31, 1e200])
def test_a_baseline_beyond_float32_is_refused_whatever_is_trusted(times):
    """The network computes in float32 with near as its unit, and refuses results that are not finite."""
    cameras = ring((0, 0.2, 0.4))
    pose = cameras[2].world_from_cam.copy()
    pose[:3, 3] *= times
    with pytest.raises(BaselineError, match=r"views 0 and 2 stand .* apart at near = 3, need at most 1e") as caught:
        check_views([*cameras[:2], cameras[2].posed(pose)], given(), trust_poses=True)
    assert caught.value.index == 2


@pytest.mark.case("P2")
def test_one_pair_with_parallax_is_enough():
    cameras = ring((0, 0.3))
    turned = cameras[0].world_from_cam.copy()
    turned[:3, :3] = about_axis(UP, 0.05)
    assert check_views([*cameras, cameras[0].posed(turned)], given()) == []


def test_a_normalised_principal_point_is_recognised():
    good = ring((0, 0.3))
    bad = Camera.make(64, 48, 60, 60, 0.5, 0.5, good[1].world_from_cam)
    with pytest.raises(IntrinsicsError, match=r"cx, cy = 0.5, 0.5 px") as caught:
        check_views([good[0], bad], given())
    assert caught.value.index == 1
    assert "look normalised; in pixels they are 32, 24" in caught.value.cure


@pytest.mark.parametrize(
    ("width", "cx", "cy", "refused"),
    [(64, 1.0, 1.0, True), (64, 1.01, 1.0, False), (64, 1.0, 1.01, False), (64, 0.0, 0.5, False), (8, 0.5, 0.5, False)],
)
def test_a_principal_point_counts_as_normalised_up_to_1(width, cx, cy, refused):
    """Not that of a crop at the corner itself, nor in a picture where a pixel is an eighth."""
    cameras = [Camera.make(width, 48, width, 60, cx, cy, camera.world_from_cam) for camera in ring((0, 0.05))]
    if not refused:
        assert check_views(cameras, given(), trust_poses=True) is not None
        return
    with pytest.raises(IntrinsicsError, match="these look normalised"):
        check_views(cameras, given())


def test_opengl_axes_are_recognised():
    cameras = [camera.posed(camera.world_from_cam @ FLIP) for camera in ring((-0.55, 0.55))]
    for depths in (given(), depth_range(cameras)):
        with pytest.raises(OverlapError, match=r"shares at most \d+ % of its picture") as caught:
            check_views(cameras, depths)
        assert "OpenGL axes (x right, y up, z backward)" in caught.value.cure


def test_world_to_camera_is_recognised():
    """A ring that looks at one point: inverted, the cameras stand elsewhere and look past it."""
    cameras = []
    for angle in (-0.5, 0.5):
        rotation = about_axis(np.array([1.0, 0.0, 0.0]), 0.9) @ about_axis(UP, angle)
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = rotation @ [0.0, 0.0, -6.0]
        cameras.append(Camera.make(64, 48, 200.0, 200.0, 32, 24, pose))
    assert check_views(cameras, given()) == []
    inverted = [camera.posed(rigid_inverse(camera.world_from_cam)) for camera in cameras]
    for check in (lambda: check_views(inverted, given()), lambda: depth_range(inverted)):
        with pytest.raises(BaselineError) as caught:  # about the origin every inverse has the same centre
            check()
        assert "if these are world-to-camera matrices" in caught.value.cure
    shift = np.eye(4)
    shift[:3, 3] = [9.0, 4.0, -2.0]  # the world's origin elsewhere, as in any real file
    inverted = [camera.posed(rigid_inverse(shift @ camera.world_from_cam)) for camera in cameras]
    with pytest.raises(OverlapError) as caught:
        check_views(inverted, given())
    assert "look like world-to-camera matrices" in caught.value.cure


def test_inverting_is_no_cure_where_it_brings_cameras_hardly_farther_apart():
    """Cameras side by side at a tiny distance: the inverse poses are as close."""
    pose = np.eye(4)
    pose[0, 3] = 1e-4
    (camera,) = ring((0,))
    cameras = [camera.posed(np.eye(4)), camera.posed(pose)]
    with pytest.raises(BaselineError, match="no pair of views has parallax") as caught:
        check_views(cameras, given())
    assert "world-to-camera" not in caught.value.cure


def test_views_that_never_meet_are_refused_without_a_false_hint():
    """Back to back: no reading of these poses overlaps."""
    cameras = ring((0,))
    pose = np.eye(4)
    pose[:3, :3] = about_axis(UP, np.pi / 2)
    pose[:3, 3] = [3.0, 0, 0]
    with pytest.raises(OverlapError, match="view 0 shares at most 0 %") as caught:
        check_views([*cameras, cameras[0].posed(pose)], given())
    assert "look like" not in caught.value.cure


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_what_overlaps_outside_an_estimated_range_is_a_warning(unit):
    cameras = ring((-0.2, 0.2), distance=6.0 * unit)
    shared_at_six = DepthRange(0.5 * unit, 0.8 * unit, "estimated")  # a bad estimate: the views cross beyond it
    assert [notice["code"] for notice in check_views(cameras, shared_at_six)] == ["little_overlap"]
    with pytest.raises(OverlapError, match=f"at any depth from {0.5 * unit:g} to {0.8 * unit:g}"):
        check_views(cameras, DepthRange(0.5 * unit, 0.8 * unit, "given"))


def test_trusted_poses_are_not_refused_for_their_overlap():
    cameras = [camera.posed(camera.world_from_cam @ FLIP) for camera in ring((-0.55, 0.55))]
    for depths in (given(), depth_range(cameras)):
        with pytest.raises(OverlapError, match="set trust_poses"):
            check_views(cameras, depths)
        (notice,) = check_views(cameras, depths, trust_poses=True)
        assert notice["code"] == "little_overlap"


def test_little_overlap_is_a_warning():
    cameras = ring((0,))
    pose = np.eye(4)
    pose[0, 3] = 10.0  # at far = 12 the shift is 50 of 64 px: a share of 0.22
    notices = check_views([*cameras, cameras[0].posed(pose)], given())
    assert [notice["code"] for notice in notices] == ["little_overlap"]


@pytest.mark.case("P3")
def test_a_wide_depth_range_is_a_warning_with_its_steps():
    notices = range_notices(given(near=0.01, far=1e4))
    assert [notice["code"] for notice in notices] == ["depth_range_wide"]
    assert "far / near = 1e+06: depth steps are coarse beyond 0.1;" in notices[0]["message"]
    assert "64 planes, by depth: 0.01: 0.79 %, 0.1: 7.4 %" in notices[0]["message"]  # z h / (1 + z h), h = 100 / 126
    (notice,) = range_notices(given(near=0.01, far=1e4), 128)
    assert "128 planes, by depth: 0.01: 0.39 %, 0.1: 3.8 %" in notice["message"]
    assert range_notices(given(near=1.0, far=1000.0)) == []
    assert len(range_notices(given(near=1.0, far=1001.0))) == 1


@pytest.mark.case("E18")
def test_the_answer_does_not_depend_on_the_unit():
    for unit in (1e-6, 1.0, 1e6):
        cameras = ring((0, 0.3), distance=6 * unit)
        assert check_views(cameras, given(3 * unit, 12 * unit)) == []
        flipped = [camera.posed(camera.world_from_cam @ FLIP) for camera in ring((-0.35, 0.35), distance=6 * unit)]
        with pytest.raises(OverlapError):
            check_views(flipped, given(3 * unit, 12 * unit))


def test_other_readings_undo_the_mistakes():
    cameras = ring((0.1, 0.4))
    mistakes = [
        lambda pose: rigid_inverse(pose),
        lambda pose: pose @ FLIP,
        lambda pose: rigid_inverse(pose @ FLIP),
    ]
    for place, mistake in enumerate(mistakes):
        wrong = [camera.posed(mistake(camera.world_from_cam)) for camera in cameras]
        for undone, camera in zip(other_readings(wrong)[place].cameras, cameras, strict=True):
            np.testing.assert_allclose(undone.world_from_cam, camera.world_from_cam, atol=1e-14)
