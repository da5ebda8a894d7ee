"""A name finds its photograph, never that of another view, in any folder and spelling."""

from __future__ import annotations

import json
import unicodedata
from pathlib import Path

import pytest
from capture_scenes import arc, photograph, write_photographs, zipped

from gapmes.service.cameras.camera_file import camera_document
from gapmes.service.captures import elsewhere, names
from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.elsewhere import Elsewhere
from gapmes.service.captures.files import FolderFiles
from gapmes.service.captures.names import MOST_PARTS, Endings, places_of, same_file, same_path
from gapmes.service.captures.photographs import is_photograph
from gapmes.service.captures.select import ViewSelection, named_views
from gapmes.service.errors import CaptureError, ImageError, ViewError

RIG = [f"{camera}/{index:04d}.png" for camera in ("cam0", "cam1") for index in range(4)]


def capture_of(root: Path, named: list[str], there: list[str]) -> Path:
    """Cameras under some names, and photographs, of which the i-th shows the seed i, under others."""
    write_photographs(root, there)
    views = [camera_document(camera, name) for camera, name in zip(arc(len(named)), named, strict=True)]
    (root / "cameras.json").write_text(json.dumps({"views": views}))
    return root


def test_photographs_of_one_camera_of_a_rig_are_not_those_of_the_other(tmp_path: Path) -> None:
    """Without their folders they may be either's; with them, each is its own."""
    flat = capture_of(tmp_path / "flat", RIG, [f"images/{index:04d}.png" for index in range(4)])
    with pytest.raises(ImageError, match="does not exist") as caught:
        open_capture(flat).choose(ViewSelection())
    assert "0000.png alone may be any of 2: keep their folders" in caught.value.cure
    half = capture_of(tmp_path / "half", RIG, [f"images/cam1/{index:04d}.png" for index in range(4)])
    chosen = open_capture(half).choose(ViewSelection())
    assert chosen.indices == (4, 5, 6, 7)
    assert chosen.selection["without_photograph"] == 4
    assert [chosen.read(place) for place in range(4)] == [photograph(seed) for seed in range(4)]


ELSEWHERE = {
    "images_cropped/a.PNG": "images_cropped/a.PNG has this name: if it is this photograph, put it where",
    "scan/rgb left/a.png": "scan/rgb left/a.png has this name: if it is this photograph, put it where",
    "images/a.jpeg": "images/a.jpeg has another suffix: if it is this photograph, give it the one",
}


def test_a_link_to_nowhere_is_no_photograph(tmp_path: Path) -> None:
    """As git-annex leaves what it has not fetched: such a view is passed over, or refused where it is asked for."""
    there = [f"images/{index}.png" for index in range(8)]
    path = capture_of(tmp_path, there, there)
    (path / there[3]).unlink()
    (path / there[3]).symlink_to("/nowhere/at/all.png")
    (path / "images" / "loop.png").symlink_to(path / "images" / "loop.png")
    capture = open_capture(path)
    chosen = capture.choose(ViewSelection())
    assert 3 not in chosen.indices
    assert chosen.selection["without_photograph"] == 1
    with pytest.raises(ImageError, match=r"images/3\.png does not exist"):
        capture.choose(ViewSelection(select="2,3"))


def test_a_photograph_that_goes_meanwhile_is_told(tmp_path: Path) -> None:
    chosen = open_capture(capture_of(tmp_path, ["a.png", "b.png"], ["a.png", "b.png"])).choose(ViewSelection())
    (tmp_path / "b.png").unlink()
    with pytest.raises(CaptureError, match=r"b\.png cannot be read: No such file or directory") as caught:
        chosen.read(1)
    assert caught.value.cure == "was it moved or deleted?"


@pytest.mark.parametrize("there", ["images/a.Jpg", "images/a.JPG", "images/a.jPG"])
@pytest.mark.parametrize("named", ["images/a.jpg", "images/a", "a.JPG", "A"])
def test_suffixes_are_found_in_any_case(tmp_path: Path, there: str, named: str) -> None:
    path = capture_of(tmp_path, [named, "images/c.png"], [there, "images/c.png"])
    assert open_capture(path).choose(ViewSelection()).paths == (there, "images/c.png")


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
@pytest.mark.parametrize("there", [*ELSEWHERE, "other/b.png", "Masks/a.png", "depth_maps/a.jpg"])
def test_a_missing_photograph_that_lies_elsewhere_is_told(tmp_path: Path, there: str, packed: bool) -> None:
    path = capture_of(tmp_path / "capture", ["images/a.png", "images/c.png"], [there, "images/c.png"])
    if packed:
        path = tmp_path / "capture.zip"
        path.write_bytes(zipped(tmp_path / "capture"))
    with pytest.raises(ImageError, match="does not exist") as caught:
        open_capture(path).choose(ViewSelection())
    assert caught.value.index == 0
    assert caught.value.cure.startswith(ELSEWHERE.get(there, "photographs are looked for in ., images, images_2"))
    assert "photographs are looked for in" in caught.value.cure


def test_a_photograph_beside_the_folder_of_the_cameras_is_not_told(tmp_path: Path) -> None:
    """It could not be found there, whatever it is called."""
    folder = capture_of(tmp_path / "up" / "scan", ["images/a.png", "images/b.png"], ["images/b.png"])
    write_photographs(tmp_path / "up", ["pics/a.png"])
    with pytest.raises(ImageError, match="does not exist") as caught:
        open_capture(folder.parent).choose(ViewSelection())
    assert "pics" not in caught.value.cure


def test_what_a_hint_tells_to_do_helps(tmp_path: Path) -> None:
    folder = capture_of(tmp_path, ["images/a.png", "images/b.jpg"], ["cropped/a.png", "images/b.png"])
    with pytest.raises(ImageError, match="does not exist") as caught:
        open_capture(folder).choose(ViewSelection())
    assert caught.value.cure.startswith("cropped/a.png has this name")
    (folder / "cropped" / "a.png").rename(folder / "images" / "a.png")
    with pytest.raises(ImageError, match="does not exist") as caught:
        open_capture(folder).choose(ViewSelection())
    assert caught.value.cure.startswith("images/b.png has another suffix")
    (folder / "images" / "b.png").rename(folder / "images" / "b.jpg")
    assert open_capture(folder).choose(ViewSelection()).paths == ("images/a.png", "images/b.jpg")


def test_a_missing_photograph_is_not_looked_for_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders are listed once for all missing ones, outer ones first, and no more of them than the limit."""
    (tmp_path / "a" / "b" / "c").mkdir(parents=True)
    folder = capture_of(tmp_path, ["images/a.png", "images/d.png"], ["a/b/a.png", "a/b/c/d.png"])
    listed: list[str] = []
    files = FolderFiles(folder)
    found = Elsewhere(files, "", files.folders, is_photograph)
    monkeypatch.setattr(files, "files", lambda place: listed.append(place) or FolderFiles.files(files, place))
    assert "a/b/a.png has this name" in found.hint("a.png")
    assert "a/b/c/d.png has this name" in found.hint("x/d.png")
    assert listed == ["", "a", "a/b", "a/b/c"]
    monkeypatch.setattr(elsewhere, "MOST_FOLDERS", 3)
    short = Elsewhere(files, "", files.folders, is_photograph)
    assert short.hint("a.png")
    assert short.hint("d.png") is None
    monkeypatch.setattr(elsewhere, "MOST_NAMES", 0)
    assert Elsewhere(files, "", files.folders, is_photograph).hint("a.png") is None


@pytest.mark.parametrize("above", ["", "/home/me/scans/", "C:\\scans\\rig\\", "../rig/"])
def test_as_much_of_a_name_counts_as_tells_it_from_the_others(tmp_path: Path, above: str) -> None:
    named = [above + name for name in RIG]
    capture = open_capture(capture_of(tmp_path, named, [f"images/{name}" for name in RIG]))
    assert [capture.path_of(index) for index in range(8)] == [f"images/{name}" for name in RIG]


def test_a_photograph_belongs_to_one_view(tmp_path: Path) -> None:
    capture = open_capture(capture_of(tmp_path, ["a.png", "b.png", "a"], ["images/a.png", "images/b.png"]))
    with pytest.raises(ImageError, match=r"images/a\.png is the photograph of view 0 too") as caught:
        capture.choose(ViewSelection())
    assert (caught.value.field, caught.value.index) == ("views.image", 2)
    assert capture.choose(ViewSelection(select="0,1")).paths == ("images/a.png", "images/b.png")


def test_long_names_are_neither_composed_nor_remembered() -> None:
    """Composing takes time with the square of the letters; what is remembered stays in memory."""
    long, short = ("E\u0301" * count for count in (513, 512))
    before = names._known.cache_info().currsize
    assert names.key(f"a\\{long}") == f"a/{long.lower()}"
    assert names._known.cache_info().currsize == before
    assert names.key(short) == "\u00e9" * 512


@pytest.mark.parametrize("name", ["imag\0es/0.png", "0\0.png", "imag\ud800es/0.png", "x" * 300 + "/y.png"])
def test_names_that_no_file_can_have_are_of_none(tmp_path: Path, name: str) -> None:
    capture = open_capture(capture_of(tmp_path, ["a.png", name], ["images/a.png", "images/b.png"]))
    with pytest.raises(ImageError, match="does not exist") as caught:
        capture.choose(ViewSelection())
    assert caught.value.index == 1


def test_folders_may_be_in_another_case(tmp_path: Path) -> None:
    named = ["Images/Left/0.png", "Images/Right/0.png"]
    capture = open_capture(capture_of(tmp_path / "one", named, ["images/left/0.png", "images/right/0.PNG"]))
    assert capture.choose(ViewSelection()).paths == ("images/left/0.png", "images/right/0.PNG")
    two = capture_of(tmp_path / "two", named, ["images/left/0.png", "images/RIGHT/0.png", "images/right/0.png"])
    with pytest.raises(ImageError, match=r"Right/0\.png does not exist"):
        open_capture(two).choose(ViewSelection())


def test_a_folder_of_folders_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A zip may have 20,000 of them, and as many views whose photographs are elsewhere."""
    count = 40
    named = [f"cam{index}/rgb.png" for index in range(count)]
    there = [f"frame{index}/rgb.png" for index in range(count)]
    asked: list[str] = []
    real = FolderFiles.folders
    monkeypatch.setattr(FolderFiles, "folders", lambda self, folder: asked.append(folder) or real(self, folder))
    capture = open_capture(capture_of(tmp_path, named, there))
    asked.clear()
    with pytest.raises(ImageError, match="does not exist") as caught:
        capture.choose(ViewSelection())
    assert len(asked) == len(set(asked)) < 20
    assert "has this name" not in caught.value.cure  # any view's


@pytest.mark.parametrize("forms", [("NFC", "NFD"), ("NFD", "NFC")])
@pytest.mark.parametrize("packed", [False, True])
def test_letters_may_be_composed_or_not(tmp_path: Path, forms: tuple[str, str], packed: bool) -> None:
    plain = [f"Büro_{index}.png" for index in range(2)]
    named, there = ([unicodedata.normalize(form, name) for name in plain] for form in forms)
    root = capture_of(tmp_path / "scan", named, [f"images/{name}" for name in there])
    path = root
    if packed:
        path = tmp_path / "scan.zip"
        path.write_bytes(zipped(root))
    assert open_capture(path).choose(ViewSelection()).read(1) == photograph(1)
    assert named_views(there[1], named, field="views") == [1]


@pytest.mark.parametrize(("encoding", "name"), [("utf-8", "ü ☕.png"), ("cp437", "Möbel2.png")])
def test_names_in_a_zip_that_does_not_tell_their_encoding(tmp_path: Path, encoding: str, name: str) -> None:
    """UTF-8 as macOS writes it, and an old code page."""
    instead, other = b"XXXXXX.png", "plain.png"
    write_photographs(tmp_path, [instead.decode(), other])
    views = [camera_document(camera, image) for camera, image in zip(arc(2), (name, other), strict=True)]
    (tmp_path / "cameras.json").write_text(json.dumps({"views": views}))
    path = tmp_path / "capture.zip"
    path.write_bytes(zipped(tmp_path).replace(instead, name.encode(encoding)))  # as long, so that nothing else moves
    chosen = open_capture(path).choose(ViewSelection())
    assert chosen.paths == (name, other)
    assert chosen.read(0) == photograph(0)


@pytest.mark.parametrize(
    ("typed", "index"),
    [
        ("cam1/0002.png", 6),
        ("CAM1\\0002.PNG", 6),
        ("images/cam1/0002.png", 6),
        ("rig/cam0/0002.png", None),
        ("cam7/0002.png", None),
        ("0002.png", None),
    ],
)
def test_folders_that_are_typed_count(typed: str, index: int | None) -> None:
    names = [f"images/{name}" for name in RIG]
    if index is not None:
        assert named_views(typed, names, field="views") == [index]
        return
    with pytest.raises(ViewError, match=r"is not a view index|2 views are named"):
        named_views(typed, names, field="views")


def test_photographs_that_differ_in_case_alone_are_told_apart(tmp_path: Path) -> None:
    there = ["images/a.png", "images/A.png"]
    assert open_capture(capture_of(tmp_path, ["a.png", "A.png"], there)).choose(ViewSelection()).paths == tuple(there)


@pytest.mark.parametrize(("folder", "suffix"), [("images_4", ".png"), ("input", ".png"), ("input", "")])
def test_a_view_may_be_named_by_the_path_that_was_told(tmp_path: Path, folder: str, suffix: str) -> None:
    """Where the photographs lie elsewhere than the cameras say, the answer has their paths."""
    named = [f"images/{index:03d}{suffix}" for index in range(3)]
    there = [f"{folder}/{index:03d}.png" for index in range(3)]
    capture = open_capture(capture_of(tmp_path, named, there))
    told = capture.choose(ViewSelection(select="0,2")).selection["images"]
    assert told == [there[0], there[2]]
    assert capture.choose(ViewSelection(select=",".join(told))).indices == (0, 2)
    with pytest.raises(ViewError, match="is not a view index"):
        capture.choose(ViewSelection(select="rgb/000.png,1"))


def test_a_folder_that_only_one_side_names_does_not_count() -> None:
    assert same_path("a/b/x.png", "b/x.png")
    assert same_path("x.png", "/b/x.png")
    assert same_path("./b/x.png", "b//x")
    assert not same_path("a/x.png", "b/x.png")
    assert same_file("a/x.png", "b/x.png")
    assert not same_file("x.png", None)


def test_endings_are_counted_of_different_names() -> None:
    endings = Endings(["a/x.png", "b/x.png", "b/x.png", "B\\y.png", None, "/".join("abcdefg")])
    assert (endings.count("x.png"), endings.count("b/x.png"), endings.count("y.png")) == (2, 1, 1)
    assert endings.of("a/x.png") == ["a/x.png"]
    assert endings.of("b/y.png") == ["b/y.png", "y.png"]
    assert endings.of("/".join("abcdefg"))[0] == "/".join("abcdefg"[-MOST_PARTS:])


@pytest.mark.parametrize(
    ("posted", "names", "places"),
    [
        ("0.png", ["left/0.png", "right/0.png"], [0, 1]),
        ("left/0.png", ["left/0.png", "right/0.png"], [0]),
        ("LEFT\\0.png", ["left/0.png", "right/0.png"], [0]),
        ("x/left/0.png", ["images/left/0.png", "images/right/0.png"], [0]),
        ("left/0.png", ["0.png", "right/0.png"], [0]),
        (
            "0.png",
            ["left/0.png", "0.png", None],
            [0, 1],
        ),  # browsers leave folders out
        ("images/0.png", ["0.png", "right/images/0.png"], [0, 1]),
        ("right/images/0.png", ["left/images/0.png", "right/0.png"], [0]),
        ("a/b/c/0.png", ["x/b/c/0.png", "y/z/c/0.png"], [0]),
        ("rgb/0.png", ["images/0.png", "images/1.png"], [0]),
        ("0.png", ["0", "1"], [0]),
        ("0.png", ["0", "0.png"], [1]),
        ("2.png", ["0.png", None], []),
    ],
)
def test_a_posted_name_means_the_nearest(posted: str, names: list[str | None], places: list[int]) -> None:
    assert places_of(posted, names) == places
