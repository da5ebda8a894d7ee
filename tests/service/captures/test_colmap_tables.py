"""The tables of a COLMAP model: how many rows they may have, whose pose an image has, and where its project is."""

from __future__ import annotations

import io
import struct
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.captures import colmap_binary, colmap_text
from gapmes.service.captures.capture import read_camera_file
from gapmes.service.captures.colmap import folders_below_project
from gapmes.service.captures.colmap_model import IDENTITY, ColmapFrame, ColmapImage, ColmapModel
from gapmes.service.captures.table import MAX_LISTED
from gapmes.service.errors import CameraError, InputError

HALF = MAX_LISTED // 2
RIG = struct.pack("<II", 7, HALF) + struct.pack("<iI", 0, 1) + struct.pack("<iIB", 0, 2, 0) * (HALF - 1)
FRAME = struct.pack("<II7dI", 5, 7, *[0.0] * 7, HALF) + struct.pack("<iIQ", 0, 1, 3) * HALF


@pytest.mark.parametrize(
    ("read", "row", "what"),
    [(colmap_binary.read_rigs, RIG, "sensors"), (colmap_binary.read_frames, FRAME, "images of frames")],
)
def test_rigs_and_frames_are_limited_together(read, row: bytes, what: str) -> None:
    """Two are as long as one may be."""
    rows = [struct.pack("<I", number) + row[4:] for number in range(3)]
    assert len(read(io.BytesIO(struct.pack("<Q", 2) + b"".join(rows[:2])), "a.bin")) == 2
    with pytest.raises(CameraError, match=f"a.bin says that it has {3 * HALF} {what}, the limit is {MAX_LISTED}"):
        read(io.BytesIO(struct.pack("<Q", 3) + b"".join(rows)), "a.bin")


CAMERA = struct.pack("<IiQQ3d", 7, 0, 64, 48, 60, 32, 24)
IMAGE = struct.pack("<I7dI", 7, 1, *[0] * 6, 1) + b"a\0" + bytes(8)
RIG_OF_ONE = struct.pack("<IIiI", 7, 1, 0, 1)
FRAME_OF_ONE = struct.pack("<II7dIiIQ", 7, 1, 1, *[0] * 6, 1, 0, 1, 3)
BINARY = {"cameras": CAMERA, "images": IMAGE, "rigs": RIG_OF_ONE, "frames": FRAME_OF_ONE}
TEXT = {
    "cameras": "7 SIMPLE_PINHOLE 64 48 60 32 24\n",
    "images": "7 1 0 0 0 0 0 0 1 a\n\n",
    "rigs": "7 1 CAMERA 1\n",
    "frames": "7 1 1 0 0 0 0 0 0 1 CAMERA 1 3\n",
}


@pytest.mark.parametrize("what", BINARY)
def test_an_id_that_is_there_twice_is_refused(what: str) -> None:
    """The last one would take the place of the first: a view less, or another lens."""
    binary, text = (getattr(module, f"read_{what}") for module in (colmap_binary, colmap_text))
    assert list(binary(io.BytesIO(struct.pack("<Q", 1) + BINARY[what]), "a.bin")) == [7]
    assert list(text(io.BytesIO(TEXT[what].encode()), "a.txt")) == [7]
    with pytest.raises(CameraError, match=r"a\.bin: the id 7 is that of an earlier entry"):
        binary(io.BytesIO(struct.pack("<Q", 2) + 2 * BINARY[what]), "a.bin")
    second = 3 if what == "images" else 2
    with pytest.raises(CameraError, match=rf"a\.txt, line {second}: the id 7 is that of an earlier entry"):
        text(io.BytesIO(2 * TEXT[what].encode()), "a.txt")


def test_letters_of_names_are_those_of_utf_8_in_both_forms() -> None:
    name = "Küche/æ 1.png"
    binary = colmap_binary.read_images(io.BytesIO(struct.pack("<Q", 1) + IMAGE.replace(b"a", name.encode())), "a.bin")
    text = colmap_text.read_images(io.BytesIO(TEXT["images"].replace("a", name).encode()), "a.txt")
    assert (binary[7].name, text[7].name) == (name, name)


def test_frames_in_text_are_limited_together() -> None:
    """A frame of no images is one."""
    lines = [f"{place} 7 1 0 0 0 0 0 0 {count}" + " CAMERA 1 3" * count for place, count in enumerate((HALF, HALF, 0))]
    assert len(colmap_text.read_frames(io.BytesIO("\n".join(lines).encode()), "a.txt")) == 3
    lines.append("3 7 1 0 0 0 0 0 0 1 CAMERA 1 3")
    with pytest.raises(CameraError, match=f"a.txt, line 4: a count of 1, {2 * HALF + 1} with those before it"):
        colmap_text.read_frames(io.BytesIO("\n".join(lines).encode()), "a.txt")


def test_sensors_in_text_have_a_pose_or_none() -> None:
    text = b"7 4 CAMERA 1 IMU 1 0 CAMERA 2 1 1 0 0 0 7 8 9 CAMERA 3 0\n"
    poses = {(0, 1): IDENTITY, (1, 1): None, (0, 2): (*IDENTITY[:4], 7.0, 8.0, 9.0), (0, 3): None}
    assert colmap_text.read_rigs(io.BytesIO(text), "a.txt") == {7: poses}


@pytest.mark.parametrize(
    ("read", "line"), [(colmap_text.read_rigs, b"7 -1\n"), (colmap_text.read_frames, b"7 1 1 0 0 0 0 0 0 -1\n")]
)
def test_counts_in_text_are_not_negative(read, line: bytes) -> None:
    with pytest.raises(CameraError, match=r"a\.txt, line 1: a count of -1"):
        read(io.BytesIO(line), "a.txt")


def test_images_in_text_are_limited() -> None:
    lines = [f"{number} 1 0 0 0 0 0 0 1 {number}.png\n\n" for number in range(MAX_LISTED + 1)]
    assert len(colmap_text.read_images(io.BytesIO("".join(lines[:-1]).encode()), "a.txt")) == MAX_LISTED
    with pytest.raises(CameraError, match=f"a.txt lists more than {MAX_LISTED} entries"):
        colmap_text.read_images(io.BytesIO("".join(lines).encode()), "a.txt")


def test_a_quaternion_of_any_length_is_a_rotation() -> None:
    """(2, 0, 2, 0) turns by 90 degrees about y."""
    model = ColmapModel(images={3: ColmapImage("a.png", 1, (2.0, 0.0, 2.0, 0.0, 1.0, 2.0, 3.0))})
    pose = model.pose(3)
    np.testing.assert_allclose(pose[:3, :3], about_axis(np.array([0.0, 1.0, 0.0]), np.pi / 2), atol=1e-15)
    assert pose[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_what_another_kind_of_sensor_took_is_no_image() -> None:
    """Numbers of images and of measurements of an IMU are independent of each other."""
    there, elsewhere = ((*IDENTITY[:4], *place) for place in ((1.0, 2.0, 3.0), (7.0, 8.0, 9.0)))
    rig = {(0, 1): IDENTITY, (1, 1): IDENTITY}
    frames = {4: ColmapFrame(6, there, (((0, 1), 3),)), 5: ColmapFrame(6, elsewhere, (((1, 1), 3),))}
    model = ColmapModel(images={3: ColmapImage("a.png", 1, IDENTITY)}, rigs={6: rig}, frames=frames)
    assert model.pose(3)[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_an_image_of_a_sensor_of_unknown_pose_has_its_own() -> None:
    """Not that of its frame, which is the pose of the rig's reference."""
    here, there = ((*IDENTITY[:4], *place) for place in ((1.0, 2.0, 3.0), (7.0, 8.0, 9.0)))
    frames = {4: ColmapFrame(6, there, (((0, 1), 3), ((0, 2), 5)))}
    images = {3: ColmapImage("a.png", 1, here), 5: ColmapImage("b.png", 2, here)}
    model = ColmapModel(images=images, rigs={6: {(0, 1): IDENTITY, (0, 2): None}}, frames=frames)
    assert model.pose(3)[:3, 3].tolist() == [7.0, 8.0, 9.0]
    assert model.pose(5)[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("lens", "pose", "told"),
    [
        ("2 FOV 64 48 60 60 32 24 1", "1 0 0 0 0 0 0", "camera 2 is FOV"),
        ("2 PINHOLE 64 48 nan 60 32 24", "1 0 0 0 0 0 0", "fx = nan"),
        ("9 PINHOLE 64 48 60 60 32 24", "1 0 0 0 0 0 0", "is of camera 2, which is missing"),
        ("2 PINHOLE 64 48 60 60 32 24", "1 0 0 0 0 inf 0", "1 of 16 numbers are NaN or infinite"),
        ("2 PINHOLE 64 48 60 60 32 24", "0 0 0 0 0 0 0", "'b.png' has a quaternion of length 0"),
    ],
)
def test_what_is_wrong_with_an_image_is_told_with_its_place(tmp_path: Path, lens: str, pose: str, told: str) -> None:
    """In the order of the names, whatever the ids are."""
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE 64 48 60 60 32 24\n{lens}\n")
    (tmp_path / "images.txt").write_text(f"3 {pose} 2 b.png\n\n8 1 0 0 0 0 0 0 1 a.png\n\n")
    with pytest.raises(InputError, match=told) as caught:
        read_camera_file(tmp_path)
    assert caught.value.index == 1


@pytest.mark.parametrize(
    ("folder", "above"),
    [
        ("sparse", 1),
        ("a/sparse", 1),
        ("/sparse", 1),
        ("a/sparse/1", 2),
        ("colmap/sparse", 2),
        ("a/colmap/sparse/0", 3),
        ("colmap/a/sparse", 1),
        ("a/sparse/1/b", 0),
        ("a/b", 0),
        ("/", 0),
        (".", 0),
    ],
)
def test_the_project_of_a_model_is_above_sparse(folder: str, above: int) -> None:
    assert folders_below_project(PurePosixPath(folder)) == above
