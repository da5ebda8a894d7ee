"""Camera files: ours and transforms.json, in every stated convention, and a named refusal for everything else."""

import copy
import json
import math

import numpy as np
import pytest
from PIL import Image

from gapmes.service.camera import Camera, rigid_inverse
from gapmes.service.camera_file import camera_document, load_scene_folder, parse_camera_file
from gapmes.service.errors import CameraError, ImageError, ImageUnreadable, IntrinsicsError, PoseError
from gapmes.service.rotations import about_axis

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def pose(index=0):
    matrix = np.eye(4)
    matrix[:3, :3] = about_axis(np.array([0.6, 0.0, 0.8]), 0.3 + index)
    matrix[:3, 3] = [1.5 + index, -2.0, 0.25]
    return matrix


def our_file(count=2):
    cameras = [Camera.make(640, 480, 500.5, 510.25, 322, 236.5, pose(i)) for i in range(count)]
    views = [camera_document(camera, f"images/{i:03d}.png") for i, camera in enumerate(cameras)]
    return {"near": 1, "far": 20.5, "views": views, "licence": "CC0", "suggested": {"context2": [0, 1]}}


def transforms(count=2, **top):
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": (pose(i) @ FLIP).tolist()} for i in range(count)]
    return {"fl_x": 500.0, "fl_y": 510.0, "cx": 322.0, "cy": 236.5, "w": 640, "h": 480, "frames": frames} | top


def test_our_file_reads_back_to_the_bit():
    file = parse_camera_file(json.loads(json.dumps(our_file())))
    assert (file.near, file.far) == (1.0, 20.5)
    for index, view in enumerate(file.views):
        assert view.image == f"images/{index:03d}.png"
        assert (view.camera.width, view.camera.fx, view.camera.cy) == (640, 500.5, 236.5)
        np.testing.assert_allclose(view.camera.world_from_cam, pose(index), atol=1e-15)
    again = parse_camera_file({"views": [camera_document(view.camera) for view in file.views]})
    assert again.near is None
    for one, two in zip(file.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(one.world_from_cam, two.world_from_cam, atol=1e-15)


@pytest.mark.parametrize("axes", ["opencv", "opengl"])
@pytest.mark.parametrize("direction", ["c2w", "w2c"])
def test_every_stated_convention_is_the_same_camera(axes, direction):
    file = our_file() | {"axes": axes, "pose": direction}
    for index, view in enumerate(file["views"]):
        matrix = pose(index) @ FLIP if axes == "opengl" else pose(index)
        view["c2w"] = (np.linalg.inv(matrix) if direction == "w2c" else matrix).tolist()
        if direction == "w2c":
            view["w2c"] = view.pop("c2w")
    for index, camera in enumerate(parse_camera_file(file).cameras):
        np.testing.assert_allclose(camera.world_from_cam, pose(index), atol=1e-13)


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
    with pytest.raises(IntrinsicsError, match=f"distortion {name} = 0.01") as caught:
        parse_camera_file(transforms(**{name: 0.01}))
    assert "undistort" in caught.value.cure


@pytest.mark.parametrize("top", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheye_is_refused(top):
    with pytest.raises(IntrinsicsError, match="need a pinhole"):
        parse_camera_file(transforms(**top))


def broken(path, value, base=None):
    file = copy.deepcopy(our_file() if base is None else base)
    target = file
    for key in path[:-1]:
        target = target[key]
    if value is None:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return file


@pytest.mark.parametrize(
    ("path", "value", "error", "match", "index"),
    [
        (("views", 1, "fx"), None, CameraError, "fx missing", 1),
        (("views", 1, "fx"), "500", CameraError, "fx = '500' is not a number", 1),
        (("views", 1, "fx"), True, CameraError, "is not a number", 1),
        (("views", 1, "fx"), math.nan, CameraError, "need a finite number", 1),
        (("views", 0, "width"), 10**400, CameraError, "need a finite number", 0),
        (("views", 0, "width"), 640.5, CameraError, "whole numbers", 0),
        (("views", 1, "fx"), 0.78, IntrinsicsError, "fx = 0.78 px", 1),
        (("views", 1, "fy"), -510.0, IntrinsicsError, "fy = -510", 1),
        (("views", 1, "c2w"), None, CameraError, "c2w is missing", 1),
        (("views", 1, "c2w"), [[1, 2], [3]], PoseError, "not a matrix", 1),
        (("views", 1, "c2w", 0, 3), 10**400, PoseError, "not a matrix", 1),
        (("views", 1, "c2w", 0, 0), math.inf, PoseError, "NaN or infinite", 1),
        (("views", 1, "c2w"), np.diag([1.0, 1, -1, 1]).tolist(), PoseError, "det", 1),
        (("views", 1, "c2w"), np.diag([2.0, 2, 2, 1]).tolist(), PoseError, "orthonormal|R", 1),
        (("views", 1, "image"), 7, CameraError, "not a file name", 1),
        (("views",), [], CameraError, "non-empty list", None),
        (("views", 0), 3, CameraError, "is a int, need an object", 0),
        (("near",), "close", CameraError, "near = 'close'", None),
        (("axes",), "blender", CameraError, "need one of opencv, opengl", None),
        (("pose",), "both", CameraError, "need one of c2w, w2c", None),
    ],
)
def test_malformed_files_are_refused_with_their_index(path, value, error, match, index):
    with pytest.raises(error, match=match) as caught:
        parse_camera_file(broken(path, value))
    assert caught.value.index == index


def test_normalised_focal_lengths_are_recognised():
    with pytest.raises(IntrinsicsError) as caught:
        parse_camera_file(broken(("views", 0, "fx"), 0.78))
    assert "these look normalised" in caught.value.cure


def test_w2c_without_saying_so_is_refused():
    file = our_file()
    file["views"][1]["w2c"] = file["views"][1].pop("c2w")
    with pytest.raises(CameraError, match='does not say "pose": "w2c"'):
        parse_camera_file(file)


@pytest.mark.parametrize("value", [None, 3, [], "text", {"cameras": []}])
def test_what_is_no_camera_file(value):
    with pytest.raises(CameraError):
        parse_camera_file(value)


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


def write_folder(root, name, obj, images):
    (root / "images").mkdir()
    (root / name).write_text(json.dumps(obj))
    for image in images:
        Image.new("RGB", (640, 480)).save(root / image)


def test_a_scene_folder_finds_its_photographs(tmp_path):
    write_folder(tmp_path, "cameras.json", our_file(), ["images/000.png", "images/001.png"])
    for path in (tmp_path, tmp_path / "cameras.json", str(tmp_path)):
        folder = load_scene_folder(path)
        assert folder.image_paths == (tmp_path / "images/000.png", tmp_path / "images/001.png")
        assert len(folder.file.views) == 2
    (tmp_path / "images/001.png").unlink()
    with pytest.raises(ImageError, match=r"001.png does not exist") as caught:
        load_scene_folder(tmp_path)
    assert caught.value.index == 1


def test_a_blender_folder_without_sizes_and_suffixes(tmp_path):
    frames = [{"file_path": f"./images/r_{i}", "transform_matrix": np.eye(4).tolist()} for i in range(2)]
    write_folder(
        tmp_path, "transforms.json", {"camera_angle_x": 0.7, "frames": frames}, ["images/r_0.png", "images/r_1.png"]
    )
    folder = load_scene_folder(tmp_path)
    assert [(c.width, c.height) for c in folder.file.cameras] == [(640, 480)] * 2
    assert folder.image_paths[1] == tmp_path / "images/r_1.png"
    (tmp_path / "images/r_1.png").write_text("text")
    with pytest.raises(ImageUnreadable):
        load_scene_folder(tmp_path)


def test_folders_without_a_camera_file(tmp_path):
    with pytest.raises(CameraError, match=r"holds neither cameras\.json nor transforms\.json"):
        load_scene_folder(tmp_path)
    (tmp_path / "cameras.json").write_text("{")
    with pytest.raises(CameraError, match="is not readable JSON"):
        load_scene_folder(tmp_path)


def test_inverse_is_exact_for_the_test_poses():
    np.testing.assert_allclose(rigid_inverse(pose()) @ pose(), np.eye(4), atol=1e-15)
