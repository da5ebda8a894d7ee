"""What is told about poses that were projected, or that float32 had gone over before they came."""

import numpy as np
import pytest

from gapmes.service.camera import Camera
from gapmes.service.camera_file import parse_camera_file
from gapmes.service.pose_notices import float32_shift, pose_notices
from gapmes.service.rotations import about_axis

AXIS = np.array([0.36, 0.48, 0.8])


def camera(matrix, focal=1000.0):
    return Camera.make(1024, 1024, focal, focal, 512, 512, matrix)


def pose(angle=0.4, center=(0.1, 0.2, 0.3)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = about_axis(AXIS, angle), center
    return matrix


@pytest.mark.case("P5")
def test_a_projected_pose_is_told_with_its_drift_and_what_that_moves():
    rng = np.random.default_rng(0)
    for size in (2e-5, 3e-5, 4e-5):
        given = pose()
        given[:3, :3] += size * rng.uniform(-1, 1, (3, 3))
        one, other = camera(given), camera(pose())
        [notice] = pose_notices([other, one], near=1.0)
        assert (notice["code"], notice["index"]) == ("pose_projected", 1)
        drift = np.abs(given[:3, :3].T @ given[:3, :3] - np.eye(3)).max()
        assert one.drift == pytest.approx(drift, rel=1e-9)
        turned = one.rotation.T @ given[:3, :3] @ [0.0, 0.0, 1.0]  # the ray as it was given, in the projected camera
        moved = np.abs(1000 * turned[:2] / turned[2]).max()
        assert 0 < moved <= 1000 * drift / 2 * (1 + 1e-3)
        assert f"{1000 * drift / 2:.2g} px" in notice["message"]


@pytest.mark.case("P5")
@pytest.mark.parametrize("direction", ["c2w", "w2c"])
@pytest.mark.parametrize("axes", ["opencv", "opengl"])
def test_every_convention_of_a_camera_file_keeps_what_was_given(axes, direction):
    given = np.round(pose(), 5)
    entry = {"width": 64, "height": 64, "fx": 64.0, "fy": 64.0, "cx": 32.0, "cy": 32.0, "c2w": given.tolist()}
    [one] = parse_camera_file({"axes": axes, "pose": direction, "views": [entry]}).cameras
    assert one.drift == np.abs(given[:3, :3].T @ given[:3, :3] - np.eye(3)).max() > 1e-6


def test_rotations_in_float32_or_six_decimals_are_not_worth_a_word():
    poses = [pose(), pose().astype(np.float32), np.round(pose(), 6)]
    assert pose_notices([camera(one) for one in poses], near=0.5) == []
    assert camera(pose()).drift == 0 < camera(poses[1]).drift < camera(poses[2]).drift


@pytest.mark.case("E19")
@pytest.mark.parametrize("offset", [1e3, 1e5, 1e7])
def test_the_precision_of_float32_positions_bounds_what_rounding_did(offset):
    """Points one unit off, before and after their camera's position was rounded: the shift in px stays below."""
    rng = np.random.default_rng(1)
    exact = rng.uniform(-1, 1, (200, 3)) + offset
    rounded = exact.astype(np.float32)
    shift = float32_shift(rounded, 1000.0, 1.0)
    moved = 1000 * np.abs(rounded.astype(np.float64) - exact).max()
    assert shift / 2 < moved <= shift  # as small as a bound can be, and one
    assert float32_shift(exact, 1000.0, 1.0) == 0
    cameras = [camera(pose(center=center)) for center in rounded[:3].astype(np.float64)]
    notices = pose_notices(cameras, near=1.0)
    assert [notice["code"] for notice in notices] == (["float32_positions"] if offset > 1e3 else [])
    assert pose_notices([camera(pose(center=center)) for center in exact[:3]], near=1.0) == []


@pytest.mark.case("E19")
def test_positions_beyond_float32_are_not_from_it():
    assert float32_shift(np.array([[1e39, 0, 0]]), 1.0, 1.0) == 0
    assert float32_shift(np.empty((0, 3)), 1.0, 1.0) == 0
