"""Poses at their limits: matrices that are not rotations, cameras far from the origin, pixels to depths and back."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.pose import MAX_ORTHONORMALITY_ERROR, ROUNDING, checked_pose
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.errors import PoseError

OFFSETS = [0.0, 1e3, 1e5, 1e6, 1e7]
SHIFT = np.array([1.0, -0.7, 0.4])


def turned(seed: int, angle: float) -> np.ndarray:
    """(4, 4) rotation about a random axis."""
    axis = np.random.default_rng(seed).normal(size=3)
    pose = np.eye(4)
    pose[:3, :3] = about_axis(axis / np.linalg.norm(axis), angle)
    return pose


@pytest.mark.case("P5")
@pytest.mark.parametrize("size", [1e-16, 1e-13, 1e-9, 1e-7, 1e-5, 3e-5, 1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("seed", range(5))
def test_a_drifting_rotation_is_the_nearest_rotation_or_refused(seed: int, size: float) -> None:
    """A drift up to 1e-4 is projected onto SO(3), and told where it moves a pixel by 0.01 px; more is refused."""
    pose, rng = turned(seed, 1.0 + seed), np.random.default_rng(seed)
    pose[:3, :3] += size * rng.uniform(-1, 1, (3, 3))
    drift = np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max()
    if drift > MAX_ORTHONORMALITY_ERROR:
        with pytest.raises(PoseError, match=r"max \|R\^T R - I\| = .* need at most 0\.0001 \(det ") as caught:
            checked_pose(pose, field="views.c2w", index=3)
        assert (caught.value.field, caught.value.index) == ("views.c2w", 3)
        return
    found, given = checked_pose(pose)
    found = found[:3, :3]
    assert given.drift == (drift if drift > ROUNDING else 0)
    with mp.workdps(40):  # the polar factor, by Newton's iteration
        nearest = mp.matrix(pose[:3, :3].tolist())
        for _ in range(8):
            nearest = (nearest + mp.inverse(nearest).T) / 2
        exact = np.array([[float(nearest[i, j]) for j in range(3)] for i in range(3)])
    assert np.abs(found.T @ found - np.eye(3)).max() <= 1e-14
    assert np.linalg.det(found) == pytest.approx(1, abs=1e-14)
    assert np.abs(found - exact).max() <= 1e-14  # measured 2.4e-15


@pytest.mark.case("P5")
@pytest.mark.parametrize(
    ("change", "message", "cure"),
    [
        (np.diag([1.0, 1.0, -1.0]), r"det\(R\) = -1", "mirrored"),
        (np.diag([-1.0, -1.0, -1.0]), r"det\(R\) = -1", "mirrored"),
        (0.5 * np.eye(3), r"= 0\.75, .*det 0\.125", "a scale of 0.5;"),
        (2.0 * np.eye(3), r"= 3, .*det 8\)", "a scale of 2;"),
        (-2.0 * np.eye(3), r"det\(R\) = -8", "mirrored"),
        (np.array([[1.0, 0.2, 0], [0, 1, 0], [0, 0, 1]]), r"= 0\.2, .*det 1\)", "sheared"),
        (np.diag([1.0, 1.0, 2.0]), r"= 3, .*det 2\)", "sheared"),
        (1.25 * np.round(turned(2, 0.3)[:3, :3], 3), r"det 1\.95", "a scale of 1.25"),  # it, and too few digits
        (np.round(turned(2, 0.3)[:3, :3], 3), r"= 0\.000\d+", "too few digits"),
        (np.round(turned(2, 0.3)[:3, :3], 2), r"= 0\.00\d+", "too few digits"),
        (np.round(turned(67, 0.67)[:3, :3], 4), r"= 0\.000\d+", "too few digits"),
        (1.0005 * turned(2, 0.3)[:3, :3], r"= 0\.001", "a scale of 1.0005;"),
        (np.zeros((3, 3)), r"= 1, .*det 0\)", "not a rotation"),
        (np.ones((3, 3)), r"det 0\)", "not a rotation"),
        (np.diag([1.0, 1.0, 0.0]), r"= 1, .*det 0\)", "not a rotation"),
    ],
)  # fmt: skip
def test_what_is_no_rotation_is_refused_with_its_determinant_and_scale(change, message, cure) -> None:
    pose = np.eye(4)
    pose[:3, :3] = change
    with pytest.raises(PoseError, match=message) as caught:
        checked_pose(pose)
    assert caught.value.field == "c2w"
    assert cure in caught.value.cure
    with pytest.raises(PoseError) as caught:
        checked_pose(turned(1, 0.4) @ pose)
    assert caught.value.field == "c2w"


def at(offset: float, pose: np.ndarray) -> np.ndarray:
    moved = pose.copy()
    moved[:3, 3] += offset * SHIFT
    return moved


def exact_projection(camera: Camera, point: np.ndarray) -> tuple[mp.mpf, mp.mpf]:
    """Of the same float64 numbers, in 60 digits."""
    offset = [mp.mpf(float(a)) - mp.mpf(float(b)) for a, b in zip(point, camera.center, strict=True)]
    x, y, z = (mp.fsum(mp.mpf(float(camera.rotation[i, j])) * offset[i] for i in range(3)) for j in range(3))
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


@pytest.mark.case("E19")
@pytest.mark.parametrize("offset", OFFSETS)
def test_pixels_far_from_the_origin(offset: float) -> None:
    """Poses come as text or float64 and stay that; numbers that were rounded to float32 before cannot be told apart."""
    rng = np.random.default_rng(0)
    camera = Camera.make(1024, 1024, 1000, 1000, 512, 512, at(offset, turned(2, 0.7)))
    pixels, depths = rng.uniform(0, 1024, (50, 2)), rng.uniform(1, 20, 50)
    points = camera.unproject(pixels, depths)
    found, _ = camera.project(points)
    with mp.workdps(60):
        for place, (one, point) in enumerate(zip(found, points, strict=True)):
            x, y = exact_projection(camera, point)
            assert abs(x - one[0]) < 1e-9  # the arithmetic itself: the subtraction comes first and is exact here
            assert abs(y - one[1]) < 1e-9
            assert (
                np.abs(one - pixels[place]).max() < 5e-4
            )  # and what the points lost by their offset: measured 5.8e-7 at 1e7


@pytest.mark.case("E19")
@pytest.mark.parametrize("offset", OFFSETS)
def test_gaussians_far_from_the_origin_lie_on_the_pixels_of_the_local_frame(offset: float) -> None:
    """What the network puts in front of camera 0, in float32, is seen at the same place in the world as locally."""
    rng = np.random.default_rng(1)
    poses = [turned(3, 0.5), turned(3, 0.6)]
    poses[1][:3, 3] = [0.5, 0.1, 0.0]
    cameras = [Camera.make(1024, 1024, 1000, 1000, 512, 512, at(offset, pose)) for pose in poses]
    depths = DepthRange(0.5, 20.0, "given")
    frame = WorldFrame.of(cameras, depths)
    z = rng.uniform(1, 40, 200)  # near is the unit
    means = np.column_stack([*(rng.uniform(-0.4, 0.4, (2, 200)) * z), z]).astype(np.float32)
    outputs = {
        "means": means,
        "scales": np.ones((200, 3), np.float32),
        "rotations_wxyz": np.tile(np.float32([1, 0, 0, 0]), (200, 1)),
        "opacities": np.ones(200, np.float32),
        "harmonics": np.zeros((200, 1, 3), np.float32),
    }
    world = frame.to_world(outputs, np.arange(200)).means
    for camera, pose in zip(cameras, poses, strict=True):
        found, _ = camera.project(world)
        local = (
            camera.posed(poses[0]).unproject(np.zeros((200, 2)), np.zeros(200))
            + 0.5 * means.astype(np.float64) @ poses[0][:3, :3].T
        )
        expected, _ = camera.posed(pose).project(local)
        assert np.abs(found - expected).max() < 5e-4  # measured 7.6e-7 at 1e7


@pytest.mark.case("P6")
@pytest.mark.parametrize("offset", OFFSETS)
def test_relative_poses_far_from_the_origin(offset: float) -> None:
    """Relative to camera 0 in float64 to 1e-8, before the network's float32 rounds them once."""
    poses = [at(offset, turned(4, 0.5)), at(offset, turned(5, 0.7))]
    poses[1][:3, 3] += [0.8, -0.1, 0.3]
    cameras = [Camera.make(640, 480, 500, 500, 320, 240, pose) for pose in poses]
    found = WorldFrame.of(cameras, DepthRange(1.0, 20.0, "given")).poses(cameras)
    assert found.dtype == np.float32
    assert np.abs(found[0] - np.eye(4)).max() < 1e-7
    with mp.workdps(60):
        first, second = (mp.matrix(pose.tolist()) for pose in poses)
        relative = mp.inverse(first) * second
        exact = np.array([[float(relative[i, j]) for j in range(4)] for i in range(4)])
    error = np.abs(found[1] - exact)
    assert (error <= 2.0**-24 * np.abs(exact) + 1e-8).all()
    assert np.abs(found[1][:3, 3] - exact[:3, 3]).max() < 1e-7


@pytest.mark.case("P9")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (31, 17), (97, 131), (255, 257), (4096, 16)])
def test_pixels_at_a_z_depth_come_back_for_any_size(width: int, height: int) -> None:
    """Depth is measured along the camera's z axis, not along the ray, which is longer towards the corners."""
    rng = np.random.default_rng(width)
    camera = Camera.make(width, height, 0.9 * width, 1.2 * height, 0.4 * width, 0.6 * height, turned(width, 0.8))
    pixels, depths = rng.uniform(0, [width, height], (100, 2)), np.exp(rng.uniform(-3, 5, 100))
    points = camera.unproject(pixels, depths)
    back, z = camera.project(points)
    assert np.abs(back - pixels).max() < 1e-9  # asked for: 1e-4
    assert np.abs(z / depths - 1).max() < 1e-12
    slopes = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    along = np.linalg.norm(points - camera.center, axis=1)
    assert np.abs(along / (depths * np.sqrt(1 + (slopes**2).sum(axis=1))) - 1).max() < 1e-12
    if width > 1:
        assert (along / depths).max() > math.sqrt(1 + 0.1)
