"""Notices about poses that were projected to rotations, or that were float32 before they arrived."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import parse_camera_file
from gapmes.service.cameras.float32 import half_step, largest_shift
from gapmes.service.cameras.pose import Given, rigid_inverse
from gapmes.service.cameras.pose_notices import pose_notices
from gapmes.service.cameras.rotations import about_axis

AXIS = np.array([0.36, 0.48, 0.8])
FOCAL = 1000.0


def camera(matrix):
    return Camera.make(1024, 1024, FOCAL, FOCAL, 512, 512, matrix)


def pose(angle=0.4, center=(0.1, 0.2, 0.3)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = about_axis(AXIS, angle), center
    return matrix


def parsed(matrix, direction="c2w", axes="opencv"):
    entry = {"width": 1024, "height": 1024, "fx": FOCAL, "fy": FOCAL, "cx": 512.0, "cy": 512.0, "c2w": matrix.tolist()}
    return parse_camera_file({"axes": axes, "pose": direction, "views": [entry]}).cameras[0]


def drifted(matrix, size, seed):
    """Off orthonormal, the same way in all entries where seed is 0: there the two products differ most."""
    noise = np.ones((3, 3)) if seed == 0 else np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    result = matrix.copy()
    result[:3, :3] = matrix[:3, :3] @ (np.eye(3) + size / 2 * (noise + noise.T) / 2)
    return result


@pytest.mark.case("P5")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("direction", ["c2w", "w2c"])
def test_a_projected_pose_is_told_with_what_that_moves(direction, seed):
    """The principal ray of the given pose, seen by the projected camera."""
    given = drifted(pose(), 9e-5, seed)
    one = parsed(given, direction)
    [notice] = pose_notices([camera(pose()), one], near=1.0)
    assert (notice["code"], notice["index"]) == ("pose_projected", 1)
    world_from_cam = given[:3, :3] if direction == "c2w" else np.linalg.inv(given[:3, :3])
    turned = one.rotation.T @ world_from_cam @ [0.0, 0.0, 1.0]
    moved = np.abs(FOCAL * turned[:2] / turned[2]).max()
    told = FOCAL * one.given.drift / 2
    assert 0 < moved <= told * (1 + 1e-3)
    assert f"by up to {told:.2g} px" in notice["message"]
    center = given[:3, 3] if direction == "c2w" else -np.linalg.solve(given[:3, :3], given[:3, 3])
    assert one.given.shift == pytest.approx(np.linalg.norm(one.center - center), rel=1e-6, abs=1e-15)


@pytest.mark.case("P5", "E19")
def test_a_camera_far_from_the_origin_that_the_projection_moves_is_told():
    """World to camera in six decimals: the pose turns by nothing that shows, but the camera stands elsewhere."""
    given = np.round(rigid_inverse(pose(center=(4.5e5, 5.4e6, 100.0))), 6)
    one = parsed(given, "w2c")
    notices = [notice for notice in pose_notices([one, parsed(given, "w2c")], near=10.0)]
    assert [notice["code"] for notice in notices] == ["pose_projected"] * 2
    assert one.given.shift > 0.5
    assert f"the camera by {one.given.shift:.3g} units" in notices[0]["message"]


@pytest.mark.case("P5")
@pytest.mark.parametrize("direction", ["c2w", "w2c"])
@pytest.mark.parametrize("axes", ["opencv", "opengl"])
def test_every_convention_of_a_camera_file_keeps_what_was_given(axes, direction):
    given = np.round(pose(), 5)
    rotation = given[:3, :3] if direction == "c2w" else given[:3, :3].T
    drift = np.abs(rotation.T @ rotation - np.eye(3)).max()
    assert parsed(given, direction, axes).given.drift == pytest.approx(drift, rel=1e-9)
    assert drift > 1e-6
    narrow = pose().astype(np.float32).astype(np.float64)
    assert parsed(narrow, direction, axes).given.step == 2.0**-26  # 0.3 lies between 2^-2 and 2^-1


def test_rotations_in_float32_or_six_decimals_are_not_worth_a_word():
    poses = [pose(), pose().astype(np.float32), np.round(pose(), 6)]
    assert pose_notices([camera(one) for one in poses], near=0.5) == []
    drifts = [camera(one).given.drift for one in poses]
    assert drifts[0] == 0 < drifts[1] < drifts[2]
    assert camera(poses[2]).posed(np.eye(4)).given.drift == 0


@pytest.mark.case("E19")
@pytest.mark.parametrize("offset", [1e3, 1e5, 1e7])
def test_the_precision_of_float32_positions_bounds_what_rounding_did(offset):
    """Points one unit off, before and after they were rounded, along the axes of cameras of any direction."""
    rng = np.random.default_rng(1)
    exact = rng.uniform(-1, 1, (200, 3)) + offset
    rounded = exact.astype(np.float32)
    shift = largest_shift(half_step(rounded), FOCAL, 1.0)
    axes = np.concatenate([rng.normal(size=(500, 3)), np.ones((1, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    moved = FOCAL * np.abs((rounded.astype(np.float64) - exact) @ axes.T).max()
    assert shift / 2 < moved <= shift
    assert half_step(exact) == 0
    cameras = [camera(pose(center=center)) for center in rounded[:3].astype(np.float64)]
    notices = pose_notices(cameras, near=1.0)
    assert [notice["code"] for notice in notices] == (["float32_positions"] if offset > 1e3 else [])
    assert pose_notices([camera(pose(center=center)) for center in exact[:3]], near=1.0) == []
    assert pose_notices([*cameras[:2], camera(pose(center=exact[2]))], near=1.0) == []  # one that was not rounded


@pytest.mark.case("P5", "E19")
@pytest.mark.parametrize(("px", "told"), [(0.099, False), (0.101, True)])
def test_what_moves_points_by_a_tenth_of_a_pixel_is_told(px, told):
    """Both the rounding of positions and what projecting a rotation does to them, with the longer focal length."""
    cameras = [camera(pose(center=center)) for center in ((1000.5, 2.0, 3.0), (1001.5, 2.0, 3.0))]
    cameras = [replace(one, fx=FOCAL / 2) for one in cameras]
    near = math.sqrt(3) * cameras[0].given.step * FOCAL / px
    notices = pose_notices(cameras, near)
    assert [notice["code"] for notice in notices] == ["float32_positions"] * told
    assert all("up to 1001.5 units from the origin" in notice["message"] for notice in notices)
    moved = replace(cameras[0], given=Given(drift=1e-9, shift=0.01))
    notices = pose_notices([moved, cameras[1]], near=0.01 * FOCAL / px)
    assert [notice["code"] for notice in notices] == ["pose_projected"] * told


@pytest.mark.case("P5")
@pytest.mark.parametrize(("px", "told"), [(0.0099, False), (0.0101, True)])
def test_what_turns_a_view_by_a_hundredth_of_a_pixel_is_told(px, told):
    turned = replace(camera(pose()), given=Given(drift=2 * px / FOCAL))
    assert [notice["code"] for notice in pose_notices([turned], near=1.0)] == ["pose_projected"] * told


@pytest.mark.case("E19")
def test_steps_are_those_of_float32():
    for value in (1.0, 3.0, 0.75, 2.0**-140, -1e5, 1e37):
        narrow = np.float32(value)
        assert half_step([0.0, float(narrow)]) == float(np.spacing(np.abs(narrow))) / 2
    assert half_step([float(np.finfo(np.float32).max)]) == 2.0**103
    assert half_step([1e39, 0, 0]) == 0
    assert half_step([]) == 0
    assert half_step([0.0]) == 2.0**-150
