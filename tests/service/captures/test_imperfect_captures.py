"""Real captures: lists written by hand, an unusable view, a model without its first view, zips from Windows."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import (
    arc,
    names,
    photograph,
    write_cameras_json,
    write_colmap,
    write_photographs,
    write_transforms,
    zipped,
)

from gapmes.service.cameras.camera_fields import CameraFile
from gapmes.service.captures.archive import ZipFiles
from gapmes.service.captures.capture import open_capture, read_camera_file
from gapmes.service.captures.colmap_text import read_images
from gapmes.service.captures.select import ViewSelection
from gapmes.service.captures.usable import usable_views
from gapmes.service.errors import CameraError, CaptureError, IntrinsicsError, PoseError, ViewCountError


def written_as_text(root: Path, count: int) -> Path:
    """The images.txt of a model, two lines for each image."""
    write_colmap(root, arc(count), text=True)
    return root / "sparse/0/images.txt"


def without_points(text: str) -> str:
    """Every second line left out, comments kept."""
    lines = text.splitlines(keepends=True)
    comments = [line for line in lines if line.startswith("#")]
    return "".join(comments + lines[len(comments) :: 2])


@pytest.mark.parametrize("count", [2, 5])
def test_a_list_without_lines_of_points_is_whole(tmp_path: Path, count: int) -> None:
    """Poses that are known, written by hand: one line for each image."""
    path = written_as_text(tmp_path, count)
    before = read_camera_file(tmp_path)
    path.write_text(without_points(path.read_text()))
    assert [line.endswith(".png") for line in path.read_text().splitlines()[-count:]] == [True] * count
    found = read_camera_file(tmp_path)
    assert [view.image for view in found.views] == names(count)
    for one, other in zip(before.cameras, found.cameras, strict=True):
        np.testing.assert_array_equal(one.world_from_cam, other.world_from_cam)


HEAD = "7 1 0 0 0 0 0 0 3 "  # id, pose and camera of an image; its name follows


@pytest.mark.parametrize(
    ("points", "count"),
    [
        ("", 2),
        ("   ", 2),
        ("1.5 2.5 -1", 2),
        ("1 2 3 " * 4, 2),
        ("1e3 nan 7", 2),
        ("1 2 3 " * 100_000, 2),
        ("1 2 3 " * 400_000, 2),  # longer than a line that is looked at
        (HEAD.replace("7", "8", 1) + "b c d.png", 3),
        (HEAD.replace("7", "8", 1) + "000001", 3),
        (HEAD.replace("7", "8", 1) + "b.png\n" + HEAD.replace("7", "9", 1) + "c.png\n1 2 3", 4),
    ],
)
def test_what_stands_below_an_image(points: str, count: int) -> None:
    text = f"{HEAD}a.png\n{points}\n{HEAD.replace('7', '5', 1)}z.png\n"
    found = read_images(io.BytesIO(text.encode()), "images.txt")
    assert (len(found), found[7].name, found[5].name) == (count, "a.png", "z.png")
    if 8 in found:
        assert found[8].name in ("b c d.png", "000001", "b.png")


def test_a_line_that_is_neither_points_nor_an_image_is_named() -> None:
    with pytest.raises(CameraError, match=r"images\.txt, line 2: an image has 4 columns, need 10"):
        read_images(io.BytesIO(f"{HEAD}a.png\n1 2 3 4\n".encode()), "images.txt")


def test_text_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(3), text=True)
    for path in (tmp_path / "sparse/0").glob("*.txt"):
        lines = [line for line in path.read_text().splitlines(keepends=True) if not line.startswith("#")]
        path.write_bytes(b"\xef\xbb\xbf" + "".join(lines).encode())
    assert [view.image for view in read_camera_file(tmp_path).views] == names(3)


def with_a_pose_of_zeros(text: str) -> str:
    return re.sub(r"(?m)^(\d+ )(\S+ ){4}(.*view 0007\.png)$", r"\g<1>0 0 0 0 \3", text)


def with_a_fisheye(text: str) -> str:
    """The eighth camera, that of view 7, becomes a fisheye."""
    return re.sub(r"(?m)^(26 )PINHOLE( .*)$", r"\1OPENCV_FISHEYE\2 0 0 0 0", text)


@pytest.mark.parametrize(
    ("file", "change", "error", "words"),
    [
        ("images.txt", with_a_pose_of_zeros, PoseError, "quaternion of length 0"),
        ("cameras.txt", with_a_fisheye, IntrinsicsError, "camera 26 is OPENCV_FISHEYE"),
    ],
)
def test_a_view_that_cannot_be_used_keeps_none_of_the_others(
    tmp_path: Path, file: str, change: Callable[[str], str], error: type[Exception], words: str
) -> None:
    """It is not chosen, and a warning says so; naming it gives the reason."""
    write_colmap(tmp_path, arc(9), text=True)
    for name in ("rigs.txt", "frames.txt"):
        (tmp_path / "sparse/0" / name).unlink()
    path = tmp_path / "sparse/0" / file
    text = path.read_text()
    path.write_text(change(text))
    assert path.read_text() != text
    assert open_capture(tmp_path).choose(ViewSelection(select="0,1")).warnings == ()
    for wanted in (ViewSelection(), ViewSelection(context=2)):
        found = open_capture(tmp_path).choose(wanted)
        assert 7 not in found.indices
        assert found.selection["of"] == 9
        (warning,) = found.warnings
        assert warning["code"] == "views_refused"
        assert warning["message"].startswith("1 of 9 views have no camera that can be used, the first is 7: ")
        assert warning["index"] == 7
        assert words in warning["message"]
    with pytest.raises(error, match=words):
        open_capture(tmp_path).choose(ViewSelection(select="0,7"))


def test_where_no_two_views_can_be_used_the_first_reason_is_told(tmp_path: Path) -> None:
    write_transforms(tmp_path, arc(8))
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"camera_model": "OPENCV_FISHEYE"}))
    with pytest.raises(IntrinsicsError, match="camera_model is OPENCV_FISHEYE") as caught:
        open_capture(tmp_path).choose(ViewSelection())
    assert caught.value.index == 0


def test_of_a_single_view_none_are_chosen(tmp_path: Path) -> None:
    write_cameras_json(tmp_path, arc(1))
    with pytest.raises(ViewCountError, match="1 view, need 2 to 6") as caught:
        open_capture(tmp_path).choose(ViewSelection(context=2))
    assert caught.value.field == "cameras"


@pytest.mark.parametrize(
    ("count", "there", "by", "chosen"),
    [(6, 6, "all", 6), (7, 7, "score", 3), (9, 6, "photographs", 6), (9, 7, "score", 3)],
)
def test_up_to_six_views_are_used_and_of_more_three(
    tmp_path: Path, count: int, there: int, by: str, chosen: int
) -> None:
    write_cameras_json(tmp_path, arc(count))
    for name in names(count)[there:]:
        (tmp_path / "images" / name).unlink()
    found = open_capture(tmp_path).choose(ViewSelection())
    assert (found.selection["by"], len(found.indices), max(found.indices) < there) == (by, chosen, True)


def test_photographs_beside_the_camera_file_come_before_those_of_the_capture(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(2))
    write_photographs(tmp_path / "sparse/0", names(2)[::-1])
    found = open_capture(tmp_path).choose(ViewSelection())
    assert found.paths == tuple(f"sparse/0/{name}" for name in names(2))
    assert found.read(0) == photograph(1)


@pytest.mark.parametrize("folder", ["sparse/1", "sparse/12", "colmap/sparse/2"])
def test_a_model_without_its_first_is_found(tmp_path: Path, folder: str) -> None:
    write_colmap(tmp_path, arc(3), folder)
    found = open_capture(tmp_path).choose(ViewSelection())
    assert (found.selection["cameras"], found.warnings) == (f"{folder}/images.bin", ())


def with_backslashes(data: bytes) -> bytes:
    """The same archive as some Windows archivers write it."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before, zipfile.ZipFile(buffer, "w") as after:
        after.writestr("scan\\", b"")
        for name in before.namelist():
            after.writestr("scan\\" + name.replace("/", "\\"), before.read(name))
    return buffer.getvalue()


def test_a_zip_with_the_slashes_of_windows(tmp_path: Path) -> None:
    (tmp_path / "scan").mkdir()
    write_cameras_json(tmp_path / "scan", arc(2))
    path = tmp_path / "scan.zip"
    path.write_bytes(with_backslashes(zipped(tmp_path / "scan")))
    found = open_capture(path).choose(ViewSelection())
    assert found.paths[1] == "scan/images/left side/view 0001.png"
    assert found.read(1) == photograph(1)


@pytest.mark.parametrize(
    ("data", "words", "cure"),
    [
        (
            photograph(0),
            r"a is no camera file, it begins with b'\\x89PNG",
            "give a folder, a .zip, or one of cameras.json",
        ),
        (b"ply\nformat ascii", "a is no camera file, it begins with b'ply.nform'", "or a RealEstate10K .txt"),
        (b'\xef\xbb\xbf {"views": [', "a is not readable JSON", "is it the camera file, and complete?"),
        (b"", "a is not readable JSON", "is it the camera file, and complete?"),
    ],
)
def test_another_kind_of_file_is_told_from_a_damaged_one(tmp_path: Path, data: bytes, words: str, cure: str) -> None:
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(CameraError, match=words) as caught:
        open_capture(tmp_path / "a")
    assert cure in str(caught.value.cure)


def test_two_spellings_of_one_path_are_one_file_twice() -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a/x.png", b"1")
        archive.writestr("a\\x.png", b"2")
    with pytest.raises(CaptureError, match=r"'a/x\.png' is there twice"):
        ZipFiles(buffer)


def test_what_is_wrong_with_all_views_together_is_said() -> None:
    """Each alone is well."""

    def cameras(indices: Sequence[int]) -> CameraFile:
        if len(indices) > 1:
            raise PoseError("is one too many", field="views.c2w")
        return CameraFile(())

    with pytest.raises(PoseError, match="is one too many"):
        usable_views(range(3), cameras)


def test_few_bad_views_of_many_cost_few_readings() -> None:
    """A reading of one view looks at the whole list of a file."""
    asked = []

    def cameras(indices: Sequence[int]) -> CameraFile:
        asked.append(len(indices))
        if bad := [index for index in indices if index in (70, 1500)]:
            raise PoseError("is none", field="views.c2w", index=bad[0])
        return CameraFile(())

    usable, _, (warning,) = usable_views(range(2000), cameras)
    assert usable == [index for index in range(2000) if index not in (70, 1500)]
    assert (warning["code"], warning["index"]) == ("views_refused", 70)
    assert "2 of 2000 views have no camera that can be used, the first is 70: " in warning["message"]
    assert len(asked) < 60
    assert usable_views([7, 70, 80], cameras)[0] == [7, 80]
    with pytest.raises(PoseError, match="is none"):
        usable_views([70, 80], cameras)
