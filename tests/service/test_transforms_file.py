"""transforms.json: its defaults, its axes, and which lenses it may name."""

import math

import numpy as np
import pytest
from camera_documents import broken, pose, transforms

from gapmes.service.camera import Camera
from gapmes.service.camera_file import parse_camera_file
from gapmes.service.distortion import largest_shift
from gapmes.service.errors import CameraError, IntrinsicsError


def test_axes_mean_directions():
    """A point up and ahead, in OpenGL words, is up and ahead in the picture."""
    file = transforms(1)
    file["frames"][0]["transform_matrix"] = np.eye(4).tolist()
    camera = parse_camera_file(file).cameras[0]
    pixels, z = camera.project(np.array([[0.0, 1.0, -5.0]]))
    assert z[0] == 5
    assert pixels[0, 1] < camera.cy


def test_transforms_with_values_at_the_top_and_per_frame():
    file = transforms(3)
    file["frames"][1] |= {"fl_x": 700.0, "w": 800, "h": 600}
    cameras = parse_camera_file(file).cameras
    assert [(c.fx, c.fy, c.width) for c in cameras] == [(500, 510, 640), (700, 510, 800), (500, 510, 640)]
    np.testing.assert_allclose(cameras[2].world_from_cam, pose(2), atol=1e-14)


def test_blender_field_of_view_and_defaults():
    angle = 0.9
    frames = transforms(2)["frames"]
    file = parse_camera_file({"camera_angle_x": angle, "w": 400, "h": 300, "frames": frames})
    camera = file.cameras[0]
    assert camera.fx == camera.fy == pytest.approx(200 / math.tan(0.45))
    assert (camera.cx, camera.cy) == (200, 150)
    right_edge = camera.rays(np.array([[400.0, 150.0], [0.0, 150.0]]))
    cosine = right_edge[0] @ right_edge[1] / np.linalg.norm(right_edge, axis=1).prod()
    assert math.acos(cosine) == pytest.approx(angle)


@pytest.mark.parametrize("name", ["k1", "k2", "k3", "k4", "p1", "p2"])
def test_distortion_is_refused_by_name(name):
    assert parse_camera_file(transforms(**{name: 0.0})).views
    with pytest.raises(IntrinsicsError, match=rf"distortion {name} = 0.05 moves .* by \d+(\.\d+)? px") as caught:
        parse_camera_file(transforms(**{name: 0.05}))
    assert "undistort" in caught.value.cure
    assert caught.value.field == f"frames.{name}"


def test_distortion_below_half_a_pixel_is_left_out():
    """k1 moves the corner that is farthest from the principal point by f k1 r^3."""
    pinhole = parse_camera_file(transforms(fl_y=500.0)).cameras[0]
    r = math.hypot(322, 480 - 236.5) / 500
    limit = 0.5 / (500 * r**3)
    assert parse_camera_file(transforms(fl_y=500.0, k1=-0.99 * limit)).cameras[0].fx == pinhole.fx
    with pytest.raises(IntrinsicsError, match=r"by 0\.505 px, need less than 0\.5 px"):
        parse_camera_file(transforms(fl_y=500.0, k1=1.01 * limit))


def test_distortion_is_the_model_of_opencv():
    """One point worked out by hand: x = 0.6, y = 0.4 at the corner, r^2 = 0.52."""
    camera = Camera.make(600, 400, 500, 500, 0, 0, np.eye(4))
    camera = camera.cropped(0, 0, 300, 200)
    k1, k2, p1, p2 = 0.1, 0.02, 0.003, 0.004
    radial = k1 * 0.52 + k2 * 0.52**2
    dx = 0.6 * radial + 2 * p1 * 0.24 + p2 * (0.52 + 0.72)
    dy = 0.4 * radial + 2 * p2 * 0.24 + p1 * (0.52 + 0.32)
    shift = largest_shift(camera, {"k1": k1, "k2": k2, "p1": p1, "p2": p2})
    assert shift == pytest.approx(500 * math.hypot(dx, dy))
    assert largest_shift(camera, {"k5": -1 / 0.52**2}) == math.inf  # the denominator is zero at the corner
    assert largest_shift(camera, {"k1": 1e308}) == math.inf


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"])
def test_models_without_distortion_are_pinholes(model):
    assert len(parse_camera_file(transforms(camera_model=model, k1=0.0, k2=0.0, p1=0.0, p2=0.0)).views) == 2


@pytest.mark.parametrize("top", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheye_is_refused(top):
    with pytest.raises(IntrinsicsError, match="need a pinhole"):
        parse_camera_file(transforms(**top))


@pytest.mark.parametrize(
    ("path", "match"),
    [
        (("w",), "w and h are missing"),
        (("fl_x",), "neither fl_x nor camera_angle_x"),
        (("frames", 0, "transform_matrix"), "transform_matrix is missing"),
    ],
)
def test_incomplete_transforms_are_refused(path, match):
    with pytest.raises(CameraError, match=match):
        parse_camera_file(broken(path, None, transforms()))


def test_a_field_of_view_in_degrees_is_refused():
    with pytest.raises(IntrinsicsError, match="camera_angle_x = 50") as caught:
        parse_camera_file({"camera_angle_x": 50.0, "w": 400, "h": 300, "frames": transforms()["frames"]})
    assert "radians" in caught.value.cure
