"""transforms.json: its defaults, its axes, and the lenses that it may have."""

import math

import numpy as np
import pytest
from camera_documents import broken, pose, transforms

from gapmes.service.cameras.camera_file import camera_document, parse_camera_file
from gapmes.service.cameras.distortion import Lens
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


def test_a_field_of_view_of_a_frame_wins_over_focal_lengths_of_the_top():
    file = transforms(3)
    file["frames"][1]["camera_angle_x"] = 0.5
    file["frames"][2] |= {"fl_x": 700.0, "camera_angle_y": 0.5}
    cameras = parse_camera_file(file).cameras
    half = math.tan(0.25)
    expected = [(500, 510), (320 / half, 320 / half), (700, 240 / half)]
    np.testing.assert_allclose([(c.fx, c.fy) for c in cameras], expected, rtol=1e-14)
    angles = {"camera_angle_x": 0.9, "camera_angle_y": 0.7, "w": 640, "h": 480}
    frames = [frame | {"fl_x": 600.0} for frame in transforms(1)["frames"]]
    (camera,) = parse_camera_file(angles | {"frames": frames}).cameras
    assert (camera.fx, camera.fy) == (600, 600)


def test_what_a_frame_says_for_y_alone_leaves_the_top_for_x():
    def focal(top: dict, own: dict) -> tuple[float, float]:
        file = transforms(1)
        file["frames"][0] |= own
        without = {name: value for name, value in file.items() if name not in ("fl_x", "fl_y")}
        (camera,) = parse_camera_file(without | top).cameras
        return camera.fx, camera.fy

    half = math.tan(0.25)
    assert focal({"fl_x": 500, "fl_y": 510}, {"camera_angle_y": 0.5}) == pytest.approx((500, 240 / half))
    assert focal({"camera_angle_x": 0.5, "camera_angle_y": 0.4}, {"fl_y": 510}) == pytest.approx((320 / half, 510))


def test_a_matrix_is_not_read_and_the_cure_says_what_is_in_it():
    frames = [
        frame | {"K": [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]} for frame in transforms(2)["frames"]
    ]
    with pytest.raises(CameraError, match="neither fl_x nor camera_angle_x is given") as caught:
        parse_camera_file({"w": 640, "h": 480, "frames": frames})
    assert caught.value.cure.endswith("of a matrix K fl_x, fl_y, cx, cy are [0][0], [1][1], [0][2], [1][2]")


@pytest.mark.parametrize("name", ["k1", "k2", "k3", "k4", "p1", "p2"])
def test_a_lens_that_bends_is_given_with_the_pinhole_it_becomes(name):
    assert parse_camera_file(transforms(**{name: 0.0})).views[0].lens is None
    view = parse_camera_file(transforms(**{name: 0.05})).views[0]
    assert getattr(view.lens, "r8" if name == "k4" else name) == 0.05
    assert (view.lens.width, view.lens.height, view.lens.cx) == (640, 480, 322.0)
    assert (view.camera.fx, view.camera.fy) == (500.0, 510.0)
    assert (view.camera.width, view.camera.height) != (640, 480)
    np.testing.assert_allclose(view.camera.world_from_cam, pose(0), atol=1e-14)


def test_frames_have_lenses_of_their_own():
    """As nerfstudio writes several cameras: intrinsics per frame, and the transform that the poses have had already."""
    file = transforms(3, k1=0.0, camera_model="OPENCV", applied_transform=[[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]])
    file["frames"][1] |= {"k1": -0.1, "fl_x": 400.0, "cx": 300.0}
    plain, bent, last = parse_camera_file(file).views
    assert (plain.lens, last.lens) == (None, None)
    assert (bent.lens.k1, bent.lens.fx, bent.lens.cx) == (-0.1, 400.0, 300.0)
    np.testing.assert_allclose(plain.camera.world_from_cam, pose(0), atol=1e-14)


def test_a_file_of_instant_ngp():
    """Both angles and both focal lengths, a lens, and members of its own: focal lengths win."""
    file = transforms(2, camera_angle_x=1.1, camera_angle_y=0.9, k1=0.04, k2=-0.05, p1=-0.001, p2=0.0005, aabb_scale=16)
    for frame in file["frames"]:
        frame |= {"file_path": f"./{frame['file_path']}", "sharpness": 20.4}
    view = parse_camera_file(file).views[1]
    assert (view.image, view.camera.fx, view.camera.fy) == ("./images/1.png", 500.0, 510.0)
    assert (view.lens.k1, view.lens.k2, view.lens.p1, view.lens.p2) == (0.04, -0.05, -0.001, 0.0005)


def test_k4_is_of_the_denominator_where_k5_or_the_model_says_so():
    for more in ({"k5": 1e-9}, {"camera_model": "FULL_OPENCV"}, {"camera_model": "full_opencv"}):
        lens = parse_camera_file(transforms(k4=0.05, **more)).views[0].lens
        assert (lens.k4, lens.r8) == (0.05, 0.0)


def test_a_lens_that_folds_is_refused():
    with pytest.raises(IntrinsicsError, match="folds the picture") as caught:
        parse_camera_file(transforms(k1=-1.0))
    assert "undistort" in caught.value.cure
    assert (caught.value.field, caught.value.index) == ("frames.distortion", 0)


def test_distortion_below_half_a_pixel_is_left_out():
    """k1 moves the corner that is farthest from the principal point by f k1 r^3."""
    pinhole = parse_camera_file(transforms(fl_y=500.0)).cameras[0]
    r = math.hypot(322, 480 - 236.5) / 500
    limit = 0.5 / (500 * r**3)
    small = parse_camera_file(transforms(fl_y=500.0, k1=-0.99 * limit)).views[0]
    assert (small.lens, small.camera.fx, small.camera.width) == (None, pinhole.fx, 640)
    large = parse_camera_file(transforms(fl_y=500.0, k1=1.01 * limit)).views[0].lens
    assert large.largest_shift() == pytest.approx(0.505)


def test_distortion_is_the_model_of_opencv():
    """One point worked out by hand: x = 0.6, y = 0.4 at the corner, r^2 = 0.52."""
    intrinsics = (300, 200, 500.0, 500.0, 0.0, 0.0)
    k1, k2, p1, p2 = 0.1, 0.02, 0.003, 0.004
    radial = k1 * 0.52 + k2 * 0.52**2
    dx = 0.6 * radial + 2 * p1 * 0.24 + p2 * (0.52 + 0.72)
    dy = 0.4 * radial + 2 * p2 * 0.24 + p1 * (0.52 + 0.32)
    shift = Lens(*intrinsics, k1=k1, k2=k2, p1=p1, p2=p2).largest_shift()
    assert shift == pytest.approx(500 * math.hypot(dx, dy))
    assert Lens(*intrinsics, k5=-1 / 0.52**2).largest_shift() == math.inf  # the denominator is zero at the corner
    assert Lens(*intrinsics, k1=1e308).largest_shift() == math.inf


@pytest.mark.parametrize("model", ["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"])
def test_models_without_distortion_are_pinholes(model):
    assert len(parse_camera_file(transforms(camera_model=model, k1=0.0, k2=0.0, p1=0.0, p2=0.0)).views) == 2


@pytest.mark.parametrize("top", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheye_is_refused(top):
    with pytest.raises(IntrinsicsError, match="need a pinhole"):
        parse_camera_file(transforms(**top))


@pytest.mark.parametrize(
    ("path", "match", "cure"),
    [
        (("w",), "w is missing", "leave both out: then the photographs tell"),
        (("h",), "h is missing", "leave both out: then the photographs tell"),
        (("fl_x",), "neither fl_x nor camera_angle_x", "give fl_x, the focal length in px"),
        (("frames", 0, "transform_matrix"), "transform_matrix is missing", "camera-to-world matrix in OpenGL axes"),
    ],
)
def test_incomplete_transforms_are_refused(path, match, cure):
    with pytest.raises(CameraError, match=match) as caught:
        parse_camera_file(broken(path, None, transforms()))
    assert cure in caught.value.cure


def test_without_a_size_the_photographs_must_tell():
    document = transforms()
    del document["w"], document["h"]
    with pytest.raises(CameraError, match="w and h are missing") as caught:
        parse_camera_file(document)
    assert "add the image size" in caught.value.cure
    views = parse_camera_file(document, size_of=lambda *_: (640, 480)).views
    assert [(view.camera.width, view.camera.height) for view in views] == [(640, 480)] * 2


@pytest.mark.parametrize("name", ["k1", "cx", "fl_y", "camera_model", "camera_angle_x"])
def test_null_counts_as_left_out(name):
    """At the top and in a frame, where it does not stand for what the top says."""
    plain = transforms()
    plain.pop(name, None)
    whole = parse_camera_file(plain)
    for document in (plain | {name: None}, plain | {"frames": [frame | {name: None} for frame in plain["frames"]]}):
        found = parse_camera_file(document)
        assert [view.camera.fx for view in found.views] == [view.camera.fx for view in whole.views]
        assert [view.camera.cx for view in found.views] == [view.camera.cx for view in whole.views]
    over = transforms(cx=20.0)
    over["frames"][0]["cx"] = None
    assert parse_camera_file(over).views[0].camera.cx == 20.0


def test_a_field_of_view_in_degrees_is_refused():
    with pytest.raises(IntrinsicsError, match="camera_angle_x = 50") as caught:
        parse_camera_file({"camera_angle_x": 50.0, "w": 400, "h": 300, "frames": transforms()["frames"]})
    assert "radians" in caught.value.cure


@pytest.mark.parametrize(("key", "other", "fixed"), [("axes", "OpenCV", "opengl"), ("pose", "w2c", "c2w")])
def test_another_convention_is_refused_and_not_passed_over(key, other, fixed):
    with pytest.raises(CameraError, match=f"{key} is {other.lower()}, and poses .* are {fixed}") as caught:
        parse_camera_file(transforms() | {key: other})
    assert caught.value.field == f"cameras.{key}"
    assert len(parse_camera_file(transforms() | {key: fixed}).cameras) == len(transforms()["frames"])


@pytest.mark.parametrize("name", ["distortion", "camera_model", "is_fisheye", "k1", "fl_x"])
@pytest.mark.parametrize("value", ["0 " * 1001, [0.0] * 101, [[0.0] * 51] * 2, {"a": {"b": [0.0] * 100}}])
def test_what_is_said_for_all_frames_is_short(name: str, value: object):
    """It is read again for each of thousands of frames: a megabyte of zeros took seconds for each."""
    with pytest.raises(
        CameraError, match=rf"^cameras\.{name}: {name} = .* longer than the numbers of a lens"
    ) as refusal:
        parse_camera_file(transforms(3) | {name: value})
    assert len(str(refusal.value)) < 200


def test_as_many_zeros_as_a_lens_has_say_nothing():
    file = transforms(2)
    expected = [camera_document(camera) for camera in parse_camera_file(file).cameras]
    for value in ([0.0] * 16, [[0.0] * 8] * 2, " ".join(["0.00000000000000000000"] * 16)):
        found = parse_camera_file(file | {"distortion": value}).cameras
        assert [camera_document(camera) for camera in found] == expected


def test_a_shift_down_is_in_the_pixels_of_fy():
    """Slopes of 0.3 and 0.4 at the corner, in px that are not square."""
    lens = Lens(240, 200, 800.0, 500.0, 0.0, 0.0, k1=0.1)
    assert lens.largest_shift() == pytest.approx(0.1 * 0.25 * math.hypot(800 * 0.3, 500 * 0.4))


def test_k4_is_of_the_denominator_where_k6_alone_says_so():
    lens = parse_camera_file(transforms(k4=0.05, k6=1e-9)).views[0].lens
    assert (lens.k4, lens.r8) == (0.05, 0.0)
