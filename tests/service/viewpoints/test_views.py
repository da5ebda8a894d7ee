"""Named views: input views to the bit, positions between them, and orbits that keep the pivot centred."""

import math

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis, rotation_angle
from gapmes.service.errors import ViewError
from gapmes.service.viewpoints.views import mean_camera, resolve_view

UP = np.array([0.0, 1.0, 0.0])


@pytest.fixture
def cameras():
    result = []
    for index in range(3):
        pose = np.eye(4)
        pose[:3, :3] = about_axis(UP, 0.2 * index - 0.2)
        pose[:3, 3] = [index - 1.0, 0.5 * index, 0.1 * index]
        result.append(Camera.make(64, 48, 60.0 + index, 62.0, 31.0 + index, 24.0, pose))
    return result


def test_input_views_are_returned_as_they_are(cameras):
    for index, camera in enumerate(cameras):
        assert resolve_view(str(index), cameras, pivot_depth=3) is camera
        assert resolve_view(f" {index}.0", cameras, pivot_depth=3) is camera


def test_a_fraction_lies_between_its_neighbours(cameras):
    half = resolve_view("1.5", cameras, pivot_depth=3)
    np.testing.assert_allclose(half.center, 0.5 * (cameras[1].center + cameras[2].center))
    np.testing.assert_allclose(half.rotation, about_axis(UP, 0.1), atol=1e-15)
    assert (half.fx, half.fy, half.cx, half.width, half.height) == (61.5, 62.0, 32.5, 64, 48)
    quarter = resolve_view("0.25", cameras, pivot_depth=3)
    assert rotation_angle(cameras[0].rotation.T @ quarter.rotation) == pytest.approx(0.05)


@pytest.mark.parametrize("count", [1 / 3, 2 / 3 + 1])
def test_a_place_has_as_many_digits_as_a_float(cameras, count):
    found = resolve_view(str(count), cameras, pivot_depth=3)
    first = int(count)
    way = cameras[first + 1].center - cameras[first].center
    np.testing.assert_allclose(found.center, cameras[first].center + (count - first) * way, atol=1e-15)
    assert resolve_view(f"orbit:{count}", cameras, pivot_depth=3).width == 64


def test_views_of_long_files_are_found(cameras):
    many = cameras[:1] * 12_000
    assert resolve_view("11999", many, pivot_depth=3) is cameras[0]
    with pytest.raises(ViewError, match="12000 is out of range, there are 12000 views"):
        resolve_view("12000", many, pivot_depth=3)


def test_a_fraction_between_sizes_takes_the_first_and_its_rays(cameras):
    doubled = [cameras[0], cameras[1].resized(128, 96)]
    same = resolve_view("0.5", cameras[:2], pivot_depth=3)
    assert resolve_view("0.5", doubled, pivot_depth=3).fx == pytest.approx(same.fx)
    assert resolve_view("0.5", doubled, pivot_depth=3).width == 64


def upright_and_wide() -> list[Camera]:
    """Two lenses of the same focal length, one with the picture upright, principal points off the middle."""
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 1.0
    return [
        Camera.make(64, 48, 50.0, 50.0, 33.0, 23.0, poses[0]),
        Camera.make(48, 64, 50.0, 50.0, 25.0, 30.0, poses[1]),
    ]


@pytest.mark.parametrize("spec", ["0.25", "0.5", "0.999", "orbit:0", "orbit:20"])
def test_pixels_stay_square_between_pictures_of_other_shapes(spec):
    for cameras in (upright_and_wide(), upright_and_wide()[::-1]):
        found = resolve_view(spec, cameras, pivot_depth=3)
        assert (found.width, found.height) == (cameras[0].width, cameras[0].height)
        assert found.fx == pytest.approx(found.fy, rel=1e-14)
    near_the_end = resolve_view("0.999", upright_and_wide(), pivot_depth=3)
    assert near_the_end.fx == pytest.approx(50 * 64 / 48, rel=1e-3)  # its width fills the picture


def test_an_orbit_keeps_the_pivot_in_its_place_and_distance(cameras):
    middle = mean_camera(cameras, 3)
    np.testing.assert_allclose(resolve_view("orbit:0", cameras, pivot_depth=3).world_from_cam, middle.world_from_cam)
    pivot = middle.center + 3 * middle.rotation[:, 2]
    up = -np.mean([camera.rotation[:, 1] for camera in cameras], axis=0)
    for degrees in (-170, -30, 12.5, 90, 360):
        camera = resolve_view(f"orbit:{degrees}", cameras, pivot_depth=3)
        pixels, z = camera.project(pivot[None])
        np.testing.assert_allclose(pixels, [[middle.cx, middle.cy]], atol=1e-9)
        assert z[0] == pytest.approx(3)
        assert (camera.center - middle.center) @ up == pytest.approx(0, abs=1e-12)  # stays on its height
        angle = rotation_angle(middle.rotation.T @ camera.rotation)
        assert angle == pytest.approx(abs(math.remainder(math.radians(degrees), 2 * math.pi)), abs=1e-9)


def test_positive_angles_go_to_the_right(cameras):
    middle = mean_camera(cameras, 3)
    moved = resolve_view("orbit:10", cameras, pivot_depth=3).center - middle.center
    assert moved @ middle.rotation[:, 0] > 0.5


def test_views_move_with_the_world(cameras):
    rotation, offset = about_axis(np.array([0.0, 0.6, 0.8]), 1.0), np.array([1e6, -2e6, 0.0])
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, offset
    moved = [camera.posed(motion @ camera.world_from_cam) for camera in cameras]
    for spec in ("0.5", "1.75", "orbit:40"):
        plain = resolve_view(spec, cameras, pivot_depth=3)
        other = resolve_view(spec, moved, pivot_depth=3)
        np.testing.assert_allclose(other.rotation, rotation @ plain.rotation, atol=1e-9)
        np.testing.assert_allclose(other.center - offset, rotation @ plain.center, atol=5e-9)  # eps of 2e6 is 2e-10


@pytest.mark.parametrize("spec", ["99", "3", "2.5", "2.000001"])
def test_places_beyond_the_last_view_say_how_many_there_are(cameras, spec):
    with pytest.raises(ViewError, match="there are 3 views: 0 to 2") as caught:
        resolve_view(spec, cameras, pivot_depth=3)
    assert caught.value.status == 422


@pytest.mark.parametrize(
    "spec",
    [
        "",
        "-1",
        "one",
        "1e0",
        "nan",
        "inf",
        "1.",
        ".5",
        "orbit",
        "orbit:",
        "orbit:x",
        "orbit:nan",
        "orbit:1e5",
        "٣",
        "0x1",
    ],
)
def test_what_is_no_view_is_refused(cameras, spec):
    with pytest.raises(ViewError, match="is not a view") as caught:
        resolve_view(spec, cameras, pivot_depth=3)
    assert "orbit:30" in caught.value.cure
