"""COLMAP's files as COLMAP reads them: pycolmap writes and reads the models that ours are compared with."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from capture_scenes import arc, colmap_model, names, write_colmap

from gapmes.service.captures.capture import open_capture, read_camera_file
from gapmes.service.captures.colmap import PARAMETERS
from gapmes.service.captures.colmap_binary import read_images
from gapmes.service.captures.colmap_model import MODELS
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CameraError, IntrinsicsError, PoseError


def rigid(rng: np.random.Generator) -> pycolmap.Rigid3d:
    quaternion = rng.normal(size=4)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion / np.linalg.norm(quaternion)), rng.normal(size=3))


def rigged_model(seed: int) -> pycolmap.Reconstruction:
    """Three cameras of a rig, four frames, the second of which lacks a camera."""
    rng, model = np.random.default_rng(seed), pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=40)
    for place, camera_id in enumerate((17, 3, 99)):
        params = [480.0 + place, 490.0, 320.0, 240.0]
        model.add_camera(pycolmap.Camera(camera_id=camera_id, model="PINHOLE", width=640, height=480, params=params))
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
        if place == 0:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(sensor, rigid(rng))
    model.add_rig(rig)
    image_id = 10
    for number in range(4):
        frame = pycolmap.Frame(frame_id=5 * number + 2, rig_id=40)
        taken = []
        for camera_id in (17, 3, 99)[: 2 if number == 1 else 3]:
            image_id += 3
            sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)
            frame.add_data_id(pycolmap.data_t(sensor, image_id))
            taken.append((image_id, camera_id))
        frame.rig_from_world = rigid(rng)
        model.add_frame(frame)
        for number_of_image, camera_id in taken:
            name = f"cam {camera_id}/{9 - number}.jpg"
            ids = {"image_id": number_of_image, "camera_id": camera_id, "frame_id": frame.frame_id}
            model.add_image(pycolmap.Image(name=name, **ids))
        model.register_frame(frame.frame_id)
    return model


def assert_same(folder: Path, theirs_in: Path | None = None) -> None:
    """Ours are the images of pycolmap's reading of the same model, in the order of their names.

    Where a text has names with spaces `theirs_in` is its binary twin: COLMAP writes such names whole into texts, but
    reads them to the first space.
    """
    model = pycolmap.Reconstruction(str(theirs_in or folder))
    theirs = sorted(model.images.values(), key=lambda image: image.name)
    ours = read_camera_file(folder).views
    assert [view.image for view in ours] == [image.name for image in theirs]
    for view, image in zip(ours, theirs, strict=True):
        camera = image.camera
        assert (view.camera.width, view.camera.height) == (camera.width, camera.height)
        np.testing.assert_array_equal(view.camera.intrinsics, camera.calibration_matrix())
        np.testing.assert_allclose(view.camera.cam_from_world[:3], image.cam_from_world().matrix(), atol=1e-13)
        np.testing.assert_allclose(view.camera.center, image.projection_center(), atol=1e-12)


def assert_written_same(folder: Path, model: pycolmap.Reconstruction, write: str, *without: str) -> None:
    (folder / "ours").mkdir()
    (folder / "theirs").mkdir()
    getattr(model, write)(str(folder / "ours"))
    model.write_binary(str(folder / "theirs"))
    for path in folder.glob("*/*"):
        if path.stem in without:
            path.unlink()
    assert_same(folder / "ours", folder / "theirs")


@pytest.mark.parametrize("write", ["write_binary", "write_text"])
@pytest.mark.parametrize("seed", range(3))
def test_rigs_and_frames(tmp_path: Path, write: str, seed: int) -> None:
    assert_written_same(tmp_path, rigged_model(seed), write)


@pytest.mark.parametrize("write", ["write_binary", "write_text"])
@pytest.mark.parametrize("older", [False, True])
def test_models_with_points_gaps_and_odd_names(tmp_path: Path, write: str, older: bool) -> None:
    """`older`: without the files of rigs and frames, which releases up to 3.11 do not know."""
    model = colmap_model(arc(7), names(7))
    assert_written_same(tmp_path, model, write, *(("rigs", "frames") if older else ()))


def test_frames_win_over_images(tmp_path: Path) -> None:
    """The same model whose images have other poses: COLMAP reads the poses of the frames, and so do we."""
    rigged_model(0).write_binary(str(tmp_path))
    data = bytearray((tmp_path / "images.bin").read_bytes())
    data[8 + 4 : 8 + 4 + 56] = struct.pack("<7d", 1, 0, 0, 0, 9, 9, 9)
    (tmp_path / "images.bin").write_bytes(data)
    assert_same(tmp_path)


@pytest.mark.parametrize("without", ["rigs", "frames"])
def test_where_rigs_or_frames_are_missing_images_have_their_own_poses(tmp_path: Path, without: str) -> None:
    rigged_model(0).write_binary(str(tmp_path))
    before = read_camera_file(tmp_path).views
    (tmp_path / f"{without}.bin").unlink()
    for view, same in zip(read_camera_file(tmp_path).views, before, strict=True):
        np.testing.assert_allclose(view.camera.world_from_cam, same.camera.world_from_cam, atol=1e-12)


def test_binary_wins_over_text_and_a_named_file_is_its_model(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(3))
    colmap_model(arc(5), names(5)).write_text(str(tmp_path / "sparse/0"))
    assert len(read_camera_file(tmp_path).views) == 3
    for form, count in (("bin", 3), ("txt", 5)):
        for name in ("images", "cameras", "rigs", "frames", "points3D"):
            assert len(read_camera_file(tmp_path / f"sparse/0/{name}.{form}").views) == count
    (tmp_path / "sparse/0/cameras.bin").unlink()
    assert len(read_camera_file(tmp_path).views) == 5
    with pytest.raises(CameraError, match=r"whole COLMAP model, need cameras\.bin and images\.bin beside it"):
        read_camera_file(tmp_path / "sparse/0/points3D.bin")
    (tmp_path / "sparse/0/cameras.txt").unlink()
    with pytest.raises(CameraError, match=r"images\.bin is not in a whole COLMAP model"):
        read_camera_file(tmp_path / "sparse/0/images.bin")


def test_our_table_of_models_is_colmaps() -> None:
    theirs = {}
    for name, number in pycolmap.CameraModelId.__members__.items():
        if name != "INVALID":
            params = pycolmap.Camera.create_from_model_id(1, number, 500.0, 640, 480).params
            theirs[int(number)] = (name, len(params))
    assert theirs == MODELS
    assert all(dict(MODELS.values())[name] == len(params) for name, params in PARAMETERS.items())


def single_camera(tmp_path: Path, model: str, params: list[float] | None = None) -> Path:
    """A model of two images of one camera, in the middle of its range unless `params` say otherwise."""
    camera = pycolmap.Camera.create_from_model_id(7, getattr(pycolmap.CameraModelId, model), 500.0, 640, 480)
    if params is not None:
        camera.params = params
    found = pycolmap.Reconstruction()
    found.add_camera_with_trivial_rig(camera)
    for index in range(2):
        image = pycolmap.Image(name=f"{index}.png", camera_id=7, image_id=index + 1)
        found.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.eye(4)[:3]))
    found.write_binary(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("model", sorted({name for name, _ in MODELS.values()} - set(PARAMETERS)))
def test_models_that_become_no_pinhole_are_refused_by_name(tmp_path: Path, model: str) -> None:
    with pytest.raises(IntrinsicsError, match=f"camera 7 is {model}, need one of SIMPLE_PINHOLE") as caught:
        read_camera_file(single_camera(tmp_path, model))
    assert (caught.value.field, caught.value.index) == ("cameras.model", 0)
    assert "image_undistorter" in caught.value.cure


BENT = {
    "SIMPLE_RADIAL": [500.0, 322.0, 236.0, -0.12],
    "RADIAL": [500.0, 322.0, 236.0, -0.2, 0.05],
    "OPENCV": [500.0, 510.0, 322.0, 236.0, -0.25, 0.08, 0.002, -0.001],
    "FULL_OPENCV": [500.0, 510.0, 322.0, 236.0, 0.1, -0.1, 0.001, 0.002, 0.02, 0.2, 0.05, 0.01],
}


@pytest.mark.parametrize("model", BENT)
def test_lenses_bend_as_colmap_says(tmp_path: Path, model: str) -> None:
    """Worst difference 2.3e-13 px to `img_from_cam`, both ways."""
    folder = single_camera(tmp_path, model, BENT[model])
    lens = read_camera_file(folder).views[0].lens
    camera = pycolmap.Reconstruction(str(folder)).cameras[7]
    rays = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 2))
    theirs = camera.img_from_cam(np.c_[rays, np.ones(200)])
    x, y = lens.distorted(*rays.T)
    np.testing.assert_allclose(x * lens.fx + lens.cx, theirs[:, 0], atol=1e-11)
    np.testing.assert_allclose(y * lens.fy + lens.cy, theirs[:, 1], atol=1e-11)
    back = np.stack(lens.undistorted((theirs[:, 0] - lens.cx) / lens.fx, (theirs[:, 1] - lens.cy) / lens.fy), axis=1)
    np.testing.assert_allclose(back, rays, atol=1e-12)


def test_the_pinhole_keeps_focal_lengths(tmp_path: Path) -> None:
    view = read_camera_file(single_camera(tmp_path, "OPENCV", BENT["OPENCV"])).views[0]
    assert (view.camera.fx, view.camera.fy) == (500.0, 510.0)
    assert view.camera.width > 640  # a barrel shows more than a pinhole of its focal length and size


def test_the_pinhole_is_the_largest_that_the_photograph_fills(tmp_path: Path) -> None:
    """Every side lies inside the photograph, and a pixel farther out it does not."""
    camera = read_camera_file(single_camera(tmp_path, "OPENCV", BENT["OPENCV"])).views[0].camera
    theirs, along = pycolmap.Reconstruction(str(tmp_path)).cameras[7], np.linspace(0.0, 1.0, 400)

    def inside(x: np.ndarray, y: np.ndarray) -> bool:
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=1)
        found = theirs.img_from_cam(rays)
        return bool(((found >= -1e-6) & (found <= np.array([640, 480]) + 1e-6)).all())

    across, down = camera.width * along, camera.height * along
    for out in (0.0, 1.0):
        assert [inside(np.full(400, x), down) for x in (-out, camera.width + out)] == [out == 0] * 2
        assert [inside(across, np.full(400, y)) for y in (-out, camera.height + out)] == [out == 0] * 2


@pytest.mark.parametrize(
    ("file", "change", "error", "words"),
    [
        ("cameras.txt", ("PINHOLE", "PINHOLES"), CameraError, "camera model PINHOLES with 4 parameters"),
        ("cameras.txt", ("5 PINHOLE", "6 PINHOLE"), CameraError, "is of camera 5, which is missing"),
        ("cameras.txt", (" 80 80 48", " 80 48"), CameraError, "with 3 parameters, need 4"),
        ("cameras.txt", (" 80 80 48", " nan 80 48"), IntrinsicsError, "fx = nan"),
        ("images.txt", ("5 left", "x left"), CameraError, r"images\.txt, line \d+: invalid literal"),
        ("rigs.txt", ("CAMERA", "SONAR"), CameraError, "sensor 'SONAR'"),
        ("rigs.txt", ("5 1 CAMERA", "5 9999999 CAMERA"), CameraError, "a count of 9999999"),
        ("rigs.txt", ("\n5 1 CAMERA", "\n6 1 CAMERA"), CameraError, r"frame \d+ is of rig 5, which is missing"),
        ("frames.txt", (" 1 CAMERA", " 2 CAMERA"), CameraError, "has too few columns"),
    ],
)
def test_lines_that_are_wrong_are_named(tmp_path: Path, file: str, change, error: type, words: str) -> None:
    write_colmap(tmp_path, arc(2), text=True)
    path = tmp_path / "sparse/0" / file
    assert change[0] in path.read_text()
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(error, match=words):
        open_capture(tmp_path).choose(ViewSelection())


@pytest.mark.parametrize("word", ["PINHOLE", "80"])
def test_a_refusal_does_not_repeat_a_word_of_any_length(tmp_path: Path, word: str) -> None:
    write_colmap(tmp_path, arc(2), text=True)
    path = tmp_path / "sparse/0/cameras.txt"
    path.write_text(path.read_text().replace(word, 9000 * "q", 1))
    with pytest.raises(CameraError, match=r"cameras\.txt, line \d+: .*q{100}") as caught:
        open_capture(tmp_path).choose(ViewSelection())
    assert len(caught.value.message) < 400


def test_comments_empty_lines_and_carriage_returns(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(3), text=True)
    for path in (tmp_path / "sparse/0").glob("*.txt"):
        path.write_bytes(b"# more\r\n\r\n" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert [view.image for view in read_camera_file(tmp_path).views] == names(3)


@pytest.mark.parametrize("numbers", [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 0.0), (1e200, 0.0, 0.0, 0.0)])
def test_quaternions_that_are_none(tmp_path: Path, numbers: tuple[float, ...]) -> None:
    single_camera(tmp_path, "PINHOLE")
    for name in ("rigs.bin", "frames.bin"):
        (tmp_path / name).unlink()
    data = bytearray((tmp_path / "images.bin").read_bytes())
    data[12 : 12 + 32] = struct.pack("<4d", *numbers)
    (tmp_path / "images.bin").write_bytes(data)
    with pytest.raises(PoseError, match="quaternion of length"):
        read_camera_file(tmp_path)


@pytest.mark.parametrize("length", [0, 1, 4095, 4096])
def test_names_of_any_length_are_read(length: int) -> None:
    row = struct.pack("<I7dI", 7, 1, 0, 0, 0, 0, 0, 0, 3) + b"x" * length + b"\0" + struct.pack("<Q", 0)
    images = read_images(io.BytesIO(struct.pack("<Q", 2) + row + row.replace(b"\7", b"\5", 1)), "images.bin")
    assert [image.name for image in images.values()] == ["x" * length] * 2


def test_names_that_do_not_end_are_refused() -> None:
    head = struct.pack("<Q", 1) + struct.pack("<I7dI", 7, 1, 0, 0, 0, 0, 0, 0, 3)
    with pytest.raises(CameraError, match="a name of more than 4096 bytes"):
        read_images(io.BytesIO(head + b"x" * 5000 + b"\0" + bytes(8)), "images.bin")
    with pytest.raises(CameraError, match=r"ends after .* in the middle of an entry"):
        read_images(io.BytesIO(head + b"xyz"), "images.bin")
