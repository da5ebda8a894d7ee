"""Camera files: ours and transforms.json, in every stated convention; all else is refused by name."""

import json
import math

import numpy as np
import pytest
from camera_documents import FLIP, broken, our_file, pose, transforms
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.camera_file import camera_document, parse_camera_file
from gapmes.service.cameras.camera_json import camera_from_json
from gapmes.service.cameras.pose import rigid_inverse
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.captures.capture import load_scene_folder, read_camera_file
from gapmes.service.errors import CameraError, CaptureError, ImageError, ImageUnreadable, IntrinsicsError, PoseError


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
        np.testing.assert_array_equal(one.world_from_cam, two.world_from_cam)


def test_a_bound_of_zero_is_not_taken_for_none():
    """It is refused where it is used."""
    assert parse_camera_file(our_file() | {"near": 0}).near == 0
    assert parse_camera_file(our_file()).depths(0.0, 0.0) == (0.0, 0.0)


@pytest.mark.case("P5")
def test_a_pose_that_was_checked_once_stays_to_the_bit():
    rng = np.random.default_rng(0)
    for _ in range(500):
        axis = rng.normal(size=3)
        matrix = np.eye(4)
        matrix[:3, :3] = about_axis(axis / np.linalg.norm(axis), rng.uniform(-np.pi, np.pi))
        matrix[:3, 3] = rng.normal(size=3)
        camera = Camera.make(640, 480, 500, 500, 320, 240, matrix)
        np.testing.assert_array_equal(camera.world_from_cam, matrix)
        rounded = Camera.make(640, 480, 500, 500, 320, 240, np.round(matrix, 6))
        for one in (camera, rounded):
            text = json.dumps(camera_document(one))
            np.testing.assert_array_equal(camera_from_json(json.loads(text)).world_from_cam, one.world_from_cam)
            again = parse_camera_file({"views": [json.loads(text)]}).cameras[0]
            np.testing.assert_array_equal(again.world_from_cam, one.world_from_cam)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"c2w": [[1, 2], [3]]}, "camera.c2w"),
        ({"c2w": None}, "camera.c2w"),
        ({"fx": -1.0}, "camera.fx"),
        ({"fx": "1"}, "camera.fx"),
        ({"width": 0.5}, "camera.width"),
        ({"image": 7}, "camera.image"),
        ({"axes": "blender"}, "camera.axes"),
        ({"pose": "both"}, "camera.pose"),
        ({"Axes": "opengl"}, "camera"),  # would be drawn as OpenCV
        ({"axis": "opengl"}, "camera"),
        ({"near": 1.0}, "camera.near"),
        ({"far": 3.0}, "camera.far"),
        ({"near_plane": 1.0}, "camera.near_plane"),
    ],
)
def test_a_single_camera_is_named_as_such(change, field):
    entry = our_file(1)["views"][0]
    camera_from_json(entry)
    with pytest.raises(CameraError) as caught:
        camera_from_json(entry | change)
    assert (caught.value.field, caught.value.index) == (field, None)
    del entry["fy"]
    with pytest.raises(CameraError, match="fy missing") as caught:
        camera_from_json(entry)
    assert (caught.value.field, caught.value.index) == ("camera", None)


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


@pytest.mark.case("P5")
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
        (("views", 1, "c2w"), np.diag([2.0, 2, 2, 1]).tolist(), PoseError, r"max \|R\^T R - I\| = 3, need", 1),
        (("views", 1, "image"), 7, CameraError, "not a file name", 1),
        (("views",), [], CameraError, "non-empty list", None),
        (("views",), 5, CameraError, "non-empty list", None),
        (("views", 0), 3, CameraError, "is a number, need an object", 0),
        (("near",), "close", CameraError, "near = 'close'", None),
        (("axes",), "blender", CameraError, "need one of opencv, opengl", None),
        (("pose",), "both", CameraError, "need one of c2w, w2c", None),
    ],
)
def test_malformed_files_are_refused_with_their_index(path, value, error, match, index):
    with pytest.raises(error, match=match) as caught:
        parse_camera_file(broken(path, value))
    assert caught.value.index == index


def test_members_of_an_object_without_views_are_listed_in_short():
    words = r"""neither "views" .* nor "frames".*, only \['far', 'near', 'q{50}'\]"""
    with pytest.raises(CameraError, match=words) as caught:
        parse_camera_file({"near": 1, "far": 2, "q" * 10**6: 3})
    assert len(caught.value.message) < 200


def test_cures_of_other_ways_to_write_intrinsics():
    with pytest.raises(CameraError) as caught:
        parse_camera_file(broken(("views", 0, "fx"), "500"))
    assert caught.value.cure == "write it without quotation marks"
    file = our_file()
    fx, fy, cx, cy = (file["views"][1].pop(name) for name in ("fx", "fy", "cx", "cy"))
    file["views"][1] |= {"R": np.eye(3).tolist(), "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]}  # a rotation is no K
    with pytest.raises(CameraError, match="fx, fy, cx, cy missing") as caught:
        parse_camera_file(file)
    assert caught.value.cure.endswith("of a matrix K fx, fy, cx, cy are [0][0], [1][1], [0][2], [1][2]")


def test_normalised_focal_lengths_are_recognised():
    with pytest.raises(IntrinsicsError) as caught:
        parse_camera_file(broken(("views", 0, "fx"), 0.78))
    assert "these look normalised; multiply fx by the image size, which would be " in caught.value.cure


@pytest.mark.parametrize("direction", ["c2w", "w2c"])
def test_of_both_directions_the_stated_one_is_read(direction):
    file = our_file() | {"pose": direction}
    for view in file["views"]:
        view["w2c"] = np.linalg.inv(view["c2w"]).tolist()
    for index, camera in enumerate(parse_camera_file(file).cameras):
        np.testing.assert_allclose(camera.world_from_cam, pose(index), atol=1e-13)


@pytest.mark.parametrize("key", ["c2w", "w2c"])
def test_a_wrong_matrix_is_named_by_its_key(key):
    file = our_file() | {"pose": "w2c"}
    file["views"][1].pop("c2w")
    file["views"][1][key] = np.diag([-1.0, 1, 1, 1]).tolist()
    with pytest.raises(PoseError) as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index) == (f"views.{key}", 1)


def test_w2c_without_saying_so_is_refused():
    file = our_file()
    file["views"][1]["w2c"] = file["views"][1].pop("c2w")
    with pytest.raises(CameraError, match='does not say "pose": "w2c"'):
        parse_camera_file(file)


@pytest.mark.parametrize("value", [None, 3, [], "text", {"cameras": []}])
def test_what_is_no_camera_file(value):
    with pytest.raises(CameraError):
        parse_camera_file(value)


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


@pytest.mark.parametrize("sizes", [True, False])
def test_only_the_chosen_photographs_must_be_there(tmp_path, sizes):
    file = transforms(3)
    if not sizes:
        del file["w"], file["h"]
    file["frames"][1]["file_path"] = None
    write_folder(tmp_path, "transforms.json", file, ["images/0.png", "images/2.png"])
    folder = load_scene_folder(tmp_path, lambda count: [count - 1, 0])
    assert folder.indices == (2, 0)
    assert folder.image_paths == (tmp_path / "images/2.png", tmp_path / "images/0.png")
    np.testing.assert_allclose(folder.file.cameras[0].world_from_cam, pose(2), atol=1e-14)
    with pytest.raises(ImageError) as caught:
        load_scene_folder(tmp_path, lambda count: [0, 1])
    assert caught.value.index == 1


def test_sizes_come_from_the_photographs(tmp_path):
    file = transforms(2)
    del file["w"], file["h"]
    write_folder(tmp_path, "transforms.json", file, ["images/0.png", "images/1.png"])
    assert read_camera_file(tmp_path / "transforms.json").cameras[1].width == 640


@pytest.mark.parametrize("read", [load_scene_folder, read_camera_file])
def test_deep_nesting_is_not_readable(tmp_path, read):
    (tmp_path / "cameras.json").write_text("[" * 200_000)
    with pytest.raises(CameraError, match="is not readable JSON"):
        read(tmp_path / "cameras.json")


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


def test_a_bare_list_of_views_is_told_where_it_belongs():
    with pytest.raises(CameraError, match="is a list, need a JSON object") as caught:
        parse_camera_file([{"width": 640}])
    assert '{"views": [...]}' in caught.value.cure


def test_folders_without_a_camera_file(tmp_path):
    with pytest.raises(CaptureError, match="is empty"):
        load_scene_folder(tmp_path)
    (tmp_path / "cameras.json").write_text("{")
    with pytest.raises(CameraError, match="is not readable JSON"):
        load_scene_folder(tmp_path)


def test_inverse_is_exact_for_the_test_poses():
    np.testing.assert_allclose(rigid_inverse(pose()) @ pose(), np.eye(4), atol=1e-15)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        (lambda f: f["views"][1].update(k1=-0.4), "views.k1", "k1 = -0.4: a cameras.json holds pinholes"),
        (lambda f: f.update(p2=0.1), "cameras.p2", "p2 = 0.1: a cameras.json holds pinholes"),
        (lambda f: f["views"][1].update(distortion=[0.1, 0]), "views.distortion", r"distortion = \[0.1, 0\]: coeff"),
        (lambda f: f.update(dist_coeffs={"k1": 0.1}), "cameras.dist_coeffs", "dist_coeffs = .*0.1"),
        (lambda f: f.update(skew=30), "cameras.skew", "skew = 30, need 0"),
        (lambda f: f["views"][0].update(is_fisheye=True), "views.is_fisheye", "is_fisheye is set"),
        (lambda f: f.update(camera_model="opencv_fisheye"), "cameras.camera_model", "is opencv_fisheye, need a pin"),
        (lambda f: f["views"][0].update(camera_model="equidistant"), "views.camera_model", "is equidistant, need"),
        (lambda f: f.update(camera_model="DOUBLE_SPHERE"), "cameras.camera_model", "is DOUBLE_SPHERE, need"),
        (lambda f: f.update(camera_model="FOV"), "cameras.camera_model", "is FOV, need"),
        (lambda f: f.update(camera_model="THIN_PRISM"), "cameras.camera_model", "is THIN_PRISM, need"),
        (lambda f: f.update(k1=None, distortion=[0.4]), "cameras.distortion", "distortion = "),
        (lambda f: f["views"][0].update(k1=0, distortion="0.4 0.1"), "views.distortion", "distortion = 0.4 0.1"),
        (lambda f: f.update(skew="3"), "cameras.skew", "skew = 3, need 0"),
        (lambda f: f["views"][1].update(axes="opengl"), "views.axes", "axes = 'opengl' stands in a view"),
        (lambda f: f["views"][0].update(near=1.0), "views.near", r"near = 1.0 stands in a view"),
        (
            lambda f: f["views"][1].update(axis="opengl"),
            "views.axis",
            "axis = 'opengl' stands in a view .*\"axes\" once",
        ),
        (lambda f: f.update(axis="opengl"), "cameras", "'axis' is not a key .*did you mean \"axes\""),
        (lambda f: f.update(Near=1.0), "cameras", "'Near' is not a key .*did you mean \"near\""),
    ],
)
def test_keys_that_would_mean_something_elsewhere_are_refused(change, field, words):
    file = json.loads(json.dumps(our_file()))
    change(file)
    with pytest.raises(CameraError, match=words) as caught:
        parse_camera_file(file)
    assert (caught.value.field, caught.value.index in (0, 1)) == (field, field.startswith("views"))


def test_keys_that_mean_nothing_are_left_alone():
    file = json.loads(json.dumps(our_file()))
    file |= {"licence": "ours", "suggested": {"context2": [0, 1]}, "year": 2026, "purpose": "near the door", "k1": None}
    file["views"][0] |= {"time": 3, "k1": 0.0, "k2": 0, "near": None, "axes": None, "skew": 1e-3, "distortion": "none"}
    file["views"][1] |= {"distortion": [0.0, 1e-9], "radial_distortion": {"k1": 0, "model": "none"}, "dist_coeffs": "0"}
    file |= {"camera_model": "pinhole", "is_fisheye": "false"}
    assert parse_camera_file(file).views[0].camera.width == 640
    for device in ("Some Phone 13 Pro", "OmniVision OV5647", "Azure Kinect NFOV", "RealSense (FOV 90)"):
        assert parse_camera_file(file | {"camera_model": device, "is_fisheye": False}).views
