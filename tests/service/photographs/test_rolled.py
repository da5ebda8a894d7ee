"""Photographs of rolled cameras: rotated with their cameras until all are aligned, for the network only."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plane_scene import PlaneScene

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.network.engine import Engine
from gapmes.service.photographs.fitting import FittedPhotos
from gapmes.service.photographs.images import FittedView, PackedView
from gapmes.service.photographs.rolled import quarter_turns, turned_camera, turned_patches, turned_photos, turned_view
from gapmes.service.reconstruct import Reconstructor, Scene

X, Y, Z = np.eye(3)


def looking(rotation: np.ndarray, size: tuple[int, int] = (40, 30)) -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, (0.3, -0.2, 0.1)
    return Camera.make(*size, 50.0, 45.0, 21.5, 13.0, pose)


def rolled(camera: Camera, degrees: float) -> Camera:
    """By so much as a turn of its picture against the clock would undo if it were negative."""
    pose = camera.world_from_cam.copy()
    pose[:3, :3] = camera.rotation @ about_axis(Z, np.radians(degrees))
    return camera.posed(pose)


@pytest.mark.parametrize("turns", [1, 2, 3, 4, -1])
def test_a_turned_camera_sees_every_point_in_the_turned_pixel(turns: int) -> None:
    camera = looking(about_axis(Y, 0.4) @ about_axis(X, -0.2))
    colours = np.arange(3 * 30 * 40, dtype=np.float32).reshape(3, 30, 40)
    view = turned_view(FittedView(colours, colours[0] > 600, camera, 1.0), turns)
    height, width = (40, 30) if turns % 2 else (30, 40)
    assert (view.camera.height, view.camera.width) == view.image.shape[1:] == (height, width)
    rows, columns = np.mgrid[:height, :width]
    pixels = np.stack([columns, rows], -1).reshape(-1, 2) + 0.5
    before, depth = camera.project(view.camera.unproject(pixels, np.full(len(pixels), 3.0)))
    np.testing.assert_allclose(depth, 3.0)
    np.testing.assert_allclose(before % 1, 0.5, atol=1e-9)
    column, row = before.astype(int).T
    np.testing.assert_array_equal(colours[:, row, column], view.image.reshape(3, -1))
    np.testing.assert_array_equal((colours[0] > 600)[row, column], view.kept.ravel())
    assert np.linalg.det(view.camera.rotation) == pytest.approx(1)


@given(st.lists(st.integers(0, 3), min_size=2, max_size=6), st.integers(0, 2**32))
def test_after_its_turns_each_stands_as_the_others(rolls: list[int], seed: int) -> None:
    """Cameras up to 40 degrees apart, rolled by quarter turns and up to 20 degrees more."""
    rng = np.random.default_rng(seed)
    cameras = []
    for roll in rolls:
        towards = about_axis(Y, rng.uniform(-0.35, 0.35)) @ about_axis(X, rng.uniform(-0.35, 0.35))
        cameras.append(rolled(looking(towards), 90 * roll + rng.uniform(-10, 10)))
    turns = quarter_turns(cameras, square=True)
    stand = {(turn + roll) % 4 for turn, roll in zip(turns, rolls, strict=True)}
    assert len(stand) == 1
    most = max(rolls.count(roll) for roll in rolls)
    assert turns.count(0) == most
    for camera, turn in zip(cameras, turns, strict=True):
        up = turned_camera(camera, turn).rotation[:, 1] @ turned_camera(cameras[0], turns[0]).rotation[:, 1]
        assert up > 0.5


def test_one_camera_given_twice_stands_as_itself() -> None:
    one = looking(np.eye(3))
    assert quarter_turns([one, one, rolled(one, 180)], square=True) == [0, 0, 2]


def test_of_two_the_first_stays() -> None:
    one = looking(np.eye(3))
    assert quarter_turns([one, rolled(one, 180)], square=True) == [0, 2]
    assert quarter_turns([rolled(one, 180), one], square=True) == [0, 2]


@pytest.mark.parametrize(("degrees", "turns"), [(0, 0), (50, 0), (60, 3), (-60, 1), (120, 3), (140, 2), (-90, 1)])
def test_little_rolls_stay(degrees: float, turns: int) -> None:
    one = looking(np.eye(3))
    assert quarter_turns([one, rolled(one, degrees)], square=True) == [0, turns]


@pytest.mark.parametrize(("degrees", "turns"), [(90, 0), (95, 0), (100, 2), (180, 2), (-170, 2)])
def test_pictures_that_are_not_square_are_turned_by_half_alone(degrees: float, turns: int) -> None:
    one = looking(np.eye(3))
    assert quarter_turns([one, rolled(one, degrees)], square=False) == [0, turns]


@pytest.mark.parametrize("down", [0.0, 0.5, 0.8])
def test_a_whole_circle_of_upright_cameras_is_left_alone(down: float) -> None:
    """Neighbours stand alike; that those opposite look the other way is no roll."""
    ring = []
    for angle in np.linspace(0, 2 * np.pi, 6, endpoint=False):
        pose = np.eye(4)
        pose[:3, :3] = about_axis(Y, angle) @ about_axis(X, -down)
        pose[:3, 3] = -4 * pose[:3, 2]
        ring.append(looking(pose[:3, :3]).posed(pose))
    assert quarter_turns(ring, square=True) == [0] * 6


def test_patches_turn_as_pictures_do() -> None:
    values = np.arange(2 * 12 * 2).reshape(2, 12, 2)
    found = turned_patches(values, (2, 0), rows=3)
    np.testing.assert_array_equal(found[0], values[0][::-1])
    np.testing.assert_array_equal(found[1], values[1])
    square = np.arange(9).reshape(1, 9)
    assert turned_patches(square, (1,), rows=3).tolist() == [[2, 5, 8, 1, 4, 7, 0, 3, 6]]


def test_a_scene_hardly_changes_where_one_camera_was_upside_down(engine: Engine) -> None:
    plane = PlaneScene.make(np.random.default_rng(5), count=2)
    pixels, camera = plane.images[1][::-1, ::-1], turned_camera(plane.cameras[1], 2)

    def scene(image: np.ndarray, reprojected: Camera) -> Scene:
        images, cameras = [plane.images[0], image], [plane.cameras[0], reprojected]
        return Reconstructor(engine).reconstruct(images, cameras, near=plane.near, far=plane.far)

    usual, found = scene(plane.images[1], plane.cameras[1]), scene(pixels, camera)
    assert [row["turned_degrees"] for row in usual.document["crop"]] == [0, 0]
    assert [row["turned_degrees"] for row in found.document["crop"]] == [0, 180]
    assert found.document["warnings"] == usual.document["warnings"]
    # what is the caller's stands as the photographs do
    np.testing.assert_array_equal(found.inputs[1], usual.inputs[1][::-1, ::-1])
    np.testing.assert_array_equal(found.view_cameras[1].rotation, camera.rotation)
    again = found.render(found.view_cameras[1]).rgb
    np.testing.assert_allclose(again, usual.render(usual.view_cameras[1]).rgb[::-1, ::-1], atol=0.02)
    maps, before = (made.document["routing"]["maps"]["experts"] for made in (found, usual))
    assert maps[0] == before[0]
    assert maps[1] == before[1][::-1]


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_photograph_turns_at_all_sizes_with_their_cameras(turns: int) -> None:
    colours = np.random.default_rng(1).integers(0, 256, (3, 16, 16)).astype(np.float32) / 255
    camera = Camera.make(16, 16, 20.0, 18.0, 7.5, 9.0, looking(about_axis(Y, 0.4)).world_from_cam)
    seen = FittedView(colours[:, ::2, ::2], None, camera.resized(8, 8), 1.0)
    shown = FittedView(colours, np.arange(256).reshape(16, 16) % 5 > 0, camera, 1.0)
    photos = FittedPhotos([seen] * 2, [shown] * 2, [PackedView.of(shown)] * 2, [])
    found = turned_photos(photos, [0, turns])
    for before, after, view in (
        (photos.seen, found.seen, seen),
        (photos.shown, found.shown, shown),
        (photos.fine, found.fine, shown),
    ):
        assert after[0] is before[0]
        expected = turned_view(view, turns)
        np.testing.assert_allclose(after[1].image, expected.image, atol=1e-7)
        assert (after[1].mask is None) == (expected.mask is None)
        if expected.mask is not None:
            np.testing.assert_array_equal(after[1].mask, expected.mask)
        np.testing.assert_array_equal(after[1].camera.intrinsics, expected.camera.intrinsics)
        np.testing.assert_array_equal(after[1].camera.world_from_cam, expected.camera.world_from_cam)
