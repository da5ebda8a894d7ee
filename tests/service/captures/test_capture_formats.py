"""One scene in every format gives the same cameras, from a folder, from a zip and from a nested folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import (
    WRITERS,
    arc,
    llff_rows,
    photograph,
    write_cameras_json,
    write_colmap,
    write_llff,
    write_photographs,
    write_realestate10k,
    write_transforms,
    zipped,
)

from gapmes.service.captures.capture import load_scene_folder, open_capture, read_camera_file
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CameraError, CaptureError, ImageError, IntrinsicsError

SAID = {
    "cameras.json": ("cameras.json", "opencv", "c2w"),
    "transforms.json": ("transforms.json", "opengl", "c2w"),
    "colmap": ("COLMAP", "opencv", "w2c"),
    "llff": ("LLFF", "opencv", "c2w"),
    "realestate10k": ("RealEstate10K", "opencv", "w2c"),
}
RAYS_PX = 1e-4  # what is promised; worst 1.4e-14 px over all formats: each writes and reads float64


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("packed", ["folder", "zip", "nested zip"])
def test_every_format_gives_the_same_rays(tmp_path: Path, form: str, packed: str) -> None:
    cameras = arc(5)
    (tmp_path / "scene").mkdir()
    WRITERS[form](tmp_path / "scene", cameras)
    path = tmp_path / "scene"
    if packed != "folder":
        inside = "my capture/" if packed == "nested zip" else ""
        path = tmp_path / "capture.bin"  # content decides, not the name
        path.write_bytes(zipped(tmp_path / "scene", inside=inside))
    capture = open_capture(path)
    found = capture.choose(ViewSelection())
    assert {camera.given.convention for camera in found.file.cameras} == {SAID[capture.table.kind]}
    assert found.indices == (0, 1, 2, 3, 4)
    assert found.selection["by"] == "all"
    pixels = np.array([[0.0, 0.0], [96.0, 0.0], [48.0, 36.0], [10.5, 71.5]])
    for place, (one, two) in enumerate(zip(cameras, found.file.cameras, strict=True)):
        assert (one.width, one.height) == (two.width, two.height)
        there, depth = two.project(one.unproject(pixels, np.full(4, 5.0)))
        np.testing.assert_allclose(there, pixels, atol=RAYS_PX)
        np.testing.assert_allclose(depth, 5.0, rtol=1e-9)
        assert found.read(place) == photograph(place)


def test_the_first_of_several_camera_files_counts(tmp_path: Path) -> None:
    """Added from the last to the first, so that each wins over those before."""
    steps = [
        (write_realestate10k, "realestate10k"),
        (write_llff, "llff"),
        (write_colmap, "colmap"),
        (WRITERS["blender"], "transforms.json"),
        (write_transforms, "transforms.json"),
        (write_cameras_json, "cameras.json"),
    ]
    sources = []
    for write, kind in steps:
        write(tmp_path, arc(2))
        table = open_capture(tmp_path).table
        assert table.kind == kind
        sources.append(table.source)
    assert sources == [
        "clip.txt",
        "poses_bounds.npy",
        "sparse/0/images.bin",
        "transforms_train.json",
        "transforms.json",
        "cameras.json",
    ]


def test_cameras_that_3dgs_training_leaves_are_passed_over(tmp_path: Path) -> None:
    """On their own they are refused, and the refusal says what they are."""
    entry = {"id": 0, "img_name": "view 0000", "width": 96, "height": 72, "position": [0, 0, 0], "fx": 80, "fy": 80}
    (tmp_path / "cameras.json").write_text(json.dumps([entry | {"rotation": np.eye(3).tolist()}]))
    with pytest.raises(CameraError, match="is the list of cameras that 3DGS training leaves") as caught:
        open_capture(tmp_path)
    assert "COLMAP" in caught.value.cure
    for write, kind in ((write_realestate10k, "realestate10k"), (write_colmap, "colmap")):
        write(tmp_path, arc(3))
        assert open_capture(tmp_path).table.kind == kind


@pytest.mark.parametrize("form", ["cameras.json", "llff", "realestate10k", "colmap binary"])
def test_a_camera_file_may_be_named_itself(tmp_path: Path, form: str) -> None:
    WRITERS[form](tmp_path, arc(3))
    source = open_capture(tmp_path).table.source
    if form != "colmap binary":
        (tmp_path / source).rename(tmp_path / "other.dat")
        source = "other.dat"
    assert len(read_camera_file(tmp_path / source).views) == 3


def test_two_captures_in_one_zip_are_not_guessed_between(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_cameras_json(tmp_path / name, arc(2))
    with pytest.raises(CaptureError, match="holds 2 captures: a, b"):
        open_capture(tmp_path)
    with pytest.raises(CaptureError, match="does not exist"):
        open_capture(tmp_path / "c")


def test_bounds_are_those_of_the_chosen_views(tmp_path: Path) -> None:
    write_llff(tmp_path, arc(8))
    capture = open_capture(tmp_path)
    assert (capture.choose(ViewSelection("1,2")).file.near, capture.choose(ViewSelection("1,2")).file.far) == (
        1.8,
        11.0,
    )
    assert (capture.choose(ViewSelection("IMG 006.png,0")).indices, capture.choose(ViewSelection("6,0")).file.far) == (
        (6, 0),
        15.0,
    )
    chosen = capture.choose(ViewSelection())
    assert chosen.file.near == pytest.approx(2.0 - 0.1 * max(chosen.indices))


def test_photographs_at_another_resolution_are_found(tmp_path: Path) -> None:
    """As mip-NeRF 360 has them: no images, but images_4."""
    write_llff(tmp_path, arc(3))
    (tmp_path / "images").rename(tmp_path / "images_4")
    assert open_capture(tmp_path).choose(ViewSelection()).paths[0] == "images_4/IMG 000.png"


def test_names_are_found_in_another_case_or_folder(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(2))
    (tmp_path / "images" / "left side").rename(tmp_path / "images" / "x")
    for path in sorted((tmp_path / "images" / "x").iterdir()):
        path.rename(tmp_path / "images" / path.name.upper())
    assert open_capture(tmp_path).choose(ViewSelection()).paths == ("images/VIEW 0000.PNG", "images/VIEW 0001.PNG")
    (tmp_path / "images" / "VIEW 0000.PNG").unlink()
    with pytest.raises(ImageError, match=r"left side/view 0000\.png does not exist") as caught:
        open_capture(tmp_path).choose(ViewSelection())
    assert caught.value.index == 0


def test_frames_of_a_clip_may_have_any_names_in_their_order(tmp_path: Path) -> None:
    write_realestate10k(tmp_path, arc(3))
    for index, path in enumerate(sorted((tmp_path / "images").iterdir())):
        path.rename(tmp_path / f"{index:05d}.png")
    assert open_capture(tmp_path).choose(ViewSelection()).paths == ("00000.png", "00001.png", "00002.png")
    (tmp_path / "00001.png").unlink()
    with pytest.raises(CaptureError, match="3 cameras without names need 3 photographs in one folder, there are 2 in"):
        open_capture(tmp_path).choose(ViewSelection())


def test_no_frame_of_a_clip_gets_the_photograph_that_another_one_names(tmp_path: Path) -> None:
    """With one name that is a time stamp, names settle it for all: the frames without one have none."""
    write_realestate10k(tmp_path, arc(3))
    (tmp_path / "clip.txt").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "clip.txt").read_bytes())  # as Windows begins it
    images = tmp_path / "images"
    assert not open_capture(tmp_path).by_sorted_name
    (images / "1000000.png").rename(images / "zz.png")
    for wanted in (ViewSelection("0,2"), ViewSelection()):
        with pytest.raises(ImageError, match="1000000 does not exist") as caught:
            open_capture(tmp_path).choose(wanted)
        assert caught.value.index == 0
    assert open_capture(tmp_path).choose(ViewSelection("1,2")).paths == ("images/1033366.png", "images/1066732.png")
    for number, path in enumerate(sorted(images.iterdir())):
        path.rename(images / f"{number}.png")
    assert open_capture(tmp_path).by_sorted_name
    assert open_capture(tmp_path).choose(ViewSelection("0,2")).paths == ("images/0.png", "images/2.png")


def test_time_stamps_that_are_also_numbers_of_frames_do_not_spoil_the_order(tmp_path: Path) -> None:
    """The photograph 0 is that of the time stamp 0 and the first of all: nothing contradicts their order."""
    write_realestate10k(tmp_path, arc(3))
    lines = (tmp_path / "clip.txt").read_text().splitlines()
    (tmp_path / "clip.txt").write_text("\n".join([lines[0], "0 " + lines[1].split(" ", 1)[1], *lines[2:]]))
    for number, path in enumerate(sorted((tmp_path / "images").iterdir())):
        path.rename(tmp_path / "images" / f"{number}.png")
    assert open_capture(tmp_path).choose(ViewSelection()).paths == ("images/0.png", "images/1.png", "images/2.png")
    (tmp_path / "images" / "2.png").unlink()  # now nothing tells whose the photograph 1 is
    with pytest.raises(ImageError, match="1033366 does not exist"):
        open_capture(tmp_path).choose(ViewSelection())


def test_of_a_large_model_those_with_a_photograph_are_used(tmp_path: Path) -> None:
    write_colmap(tmp_path, arc(20))
    for path in sorted((tmp_path / "images" / "left side").iterdir()):
        if path.name not in ("view 0003.png", "view 0005.png", "view 0011.png"):
            path.unlink()
    found = open_capture(tmp_path).choose(ViewSelection())
    assert found.indices == (3, 5, 11)
    assert (found.selection["by"], found.selection["without_photograph"]) == ("photographs", 17)
    assert open_capture(tmp_path).choose(ViewSelection(context=2)).indices in ((3, 5), (5, 11))
    (tmp_path / "images" / "left side" / "view 0003.png").unlink()
    (tmp_path / "images" / "left side" / "view 0005.png").unlink()
    with pytest.raises(ImageError, match=r"0000\.png does not exist"):
        open_capture(tmp_path).choose(ViewSelection())


def test_a_scene_folder_has_pinholes_only(tmp_path: Path) -> None:
    """Who reads photographs by their paths sees them as they are."""
    write_transforms(tmp_path, arc(2))
    assert load_scene_folder(tmp_path).image_paths[1] == tmp_path / "images/left side/view 0001.png"
    document = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "transforms.json").write_text(json.dumps(document | {"k1": -0.2}))
    assert open_capture(tmp_path).choose(ViewSelection()).file.views[0].lens is not None
    with pytest.raises(IntrinsicsError, match=r"by \d.* px, need less than 0\.5 px"):
        load_scene_folder(tmp_path)


def test_a_scene_folder_is_no_zip(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    write_cameras_json(tmp_path / "a", arc(2))
    (tmp_path / "a.zip").write_bytes(zipped(tmp_path / "a"))
    assert len(read_camera_file(tmp_path / "a.zip").views) == 2
    with pytest.raises(CaptureError, match="is a zip, need a folder"):
        load_scene_folder(tmp_path / "a.zip")


def test_what_is_beside_a_capture_does_not_matter(tmp_path: Path) -> None:
    write_llff(tmp_path, arc(3))
    (tmp_path / "readme.txt").write_text("19 words\n" * 3)
    (tmp_path / "images" / ".DS_Store").write_bytes(b"x")
    (tmp_path / "images" / "notes.md").write_text("x")
    (tmp_path / "__MACOSX").mkdir()
    write_cameras_json(tmp_path / "__MACOSX", arc(2))
    assert open_capture(tmp_path).choose(ViewSelection()).indices == (0, 1, 2)


@pytest.mark.parametrize("text", [" ".join(["word"] * 19), "7 8 9"])
def test_a_folder_without_cameras_is_no_capture_and_any_text_no_clip(tmp_path: Path, text: str) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes.txt").write_text(text)
    with pytest.raises(CaptureError, match=r"holds no cameras, only notes/, notes\.txt") as caught:
        open_capture(tmp_path)
    assert "COLMAP computes" not in str(caught.value.cure)
    write_photographs(tmp_path, ["photos/0.jpg"])
    with pytest.raises(CaptureError, match=r"holds no cameras, only notes/, photos/, notes\.txt") as caught:
        open_capture(tmp_path)
    assert str(caught.value.cure).endswith("cameras from photographs: colmap automatic_reconstructor")
    (tmp_path / "scan").mkdir()
    write_realestate10k(tmp_path / "scan", arc(2))
    clip = tmp_path / "scan" / "clip.txt"
    clip.write_text("\n \n" + clip.read_text().replace("\n", "\n\n"))
    found = open_capture(tmp_path).choose(ViewSelection())
    assert found.paths == ("scan/images/1000000.png", "scan/images/1033366.png")


@pytest.mark.parametrize(
    ("place", "value", "error", "words"),
    [
        (4, 0.5, CameraError, "whole numbers"),
        (14, -80.0, IntrinsicsError, "fx = -80"),
        (0, np.nan, CameraError, "NaN"),
        (15, -1.0, CameraError, "need 0 < near < far"),
        (15, 0.0, CameraError, "need 0 < near < far"),
        (16, np.inf, CameraError, "need 0 < near < far"),
        (16, 1.0, CameraError, "need 0 < near < far"),
        (16, 1.9, CameraError, "bounds are 1.9 and 1.9"),
    ],
)
def test_rows_that_are_no_camera(tmp_path: Path, place: int, value: float, error: type, words: str) -> None:
    rows = llff_rows(arc(3))
    rows[1, place] = value
    write_photographs(tmp_path, ["a.png", "b.png", "c.png"])
    np.save(tmp_path / "poses_bounds.npy", rows)
    with pytest.raises(error, match=words) as caught:
        open_capture(tmp_path).choose(ViewSelection())
    assert caught.value.index == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda words: words[:-1], "the line has 18 columns, need 19"),
        (lambda words: [*words[:5], "0.1", *words[6:]], "columns 6 and 7 are 0.1 and 0"),
        (lambda words: [words[0], "500", *words[2:]], "shares of the picture"),
        (lambda words: [words[0], "nan", *words[2:]], "shares of the picture"),
        (lambda words: [words[0], "wide" * 999, *words[2:]], "could not convert"),
    ],
)
def test_lines_that_are_no_camera(tmp_path: Path, change, words: str) -> None:
    write_realestate10k(tmp_path, arc(3))
    lines = (tmp_path / "clip.txt").read_text().splitlines()
    lines[2] = " ".join(change(lines[2].split()))
    (tmp_path / "clip.txt").write_text("\n".join(lines))
    with pytest.raises(CameraError, match=words) as caught:
        open_capture(tmp_path).choose(ViewSelection())
    assert caught.value.index == 1
    assert len(caught.value.message) < 500
