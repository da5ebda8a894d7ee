"""Captures with several COLMAP models, and models that are named: which is read, and where its photographs are."""

from __future__ import annotations

from pathlib import Path

import pytest
from capture_scenes import arc, names, write_colmap, zipped

from gapmes.service.captures import colmap_models
from gapmes.service.captures.capture import open_capture
from gapmes.service.captures.select import ViewSelection
from gapmes.service.errors import CameraError, CaptureError


def write_models(root: Path, counts: dict[str, int], *, text: bool = False) -> None:
    """A project with photographs and a model of so many images in each folder."""
    for folder, count in counts.items():
        write_colmap(root, arc(count), folder, text=text)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("packed", [False, True])
def test_of_several_models_one_is_read_and_the_others_are_named(tmp_path: Path, text: bool, packed: bool) -> None:
    root, path = tmp_path / "scene", tmp_path / "scene"
    write_models(root, {"sparse/0": 3, "sparse/1": 5, "sparse/10": 2, "sparse/2": 4}, text=text)
    (root / "sparse" / "notes").mkdir()
    if packed:
        path = tmp_path / "capture.zip"
        path.write_bytes(zipped(root, inside="inner/"))
    inside, form = ("inner/" if packed else ""), ("txt" if text else "bin")
    found = open_capture(path).choose(ViewSelection())
    assert found.indices == (0, 1, 2, 3, 4)
    (notice,) = found.warnings
    assert notice == {
        "code": "several_models",
        "field": "capture",
        "message": f"4 COLMAP models are there: {inside}sparse/1 (5 images) is read; ignored: {inside}sparse/0 "
        f"(3 images), {inside}sparse/2 (4 images), {inside}sparse/10 (2 images) (for another one name a file of it, "
        f"such as {inside}sparse/0/images.{form}; in a zip keep its folder alone)",
    }


@pytest.mark.parametrize(
    ("counts", "read"),
    [
        ({"sparse/0": 2, "sparse/1": 2, "sparse/2": 2}, "sparse/0"),
        ({"sparse/2": 2, "sparse/10": 3}, "sparse/10"),
        ({"sparse/0": 2, "sparse/0_before": 3, "colmap/sparse/0": 3}, "sparse/0"),
        ({"sparse": 2, "sparse/1": 3}, "sparse"),
        ({"colmap/sparse/0": 2, "colmap/sparse/1": 3}, "colmap/sparse/1"),
    ],
)
def test_the_numbered_model_with_most_images_is_read(tmp_path: Path, counts: dict[str, int], read: str) -> None:
    """The mapper numbers them as it finds them; what has another name is somebody's own."""
    write_models(tmp_path, counts)
    assert open_capture(tmp_path).choose(ViewSelection()).selection["cameras"] == f"{read}/images.bin"


@pytest.mark.parametrize("silent", ["0", "1", "01"])
def test_of_models_that_do_not_say_their_number_of_images_the_images_are_counted(tmp_path: Path, silent: str) -> None:
    write_models(tmp_path, {"sparse/0": 2, "sparse/1": 3}, text=True)
    for number in silent:
        images = tmp_path / f"sparse/{number}/images.txt"
        images.write_text("".join(line for line in images.read_text().splitlines(True) if not line.startswith("#")))
    chosen = open_capture(tmp_path).choose(ViewSelection())
    assert chosen.selection["cameras"] == "sparse/1/images.txt"
    assert "sparse/1 (3 images) is read; ignored: sparse/0 (2 images)" in chosen.warnings[0]["message"]


def test_of_many_silent_models_the_first_are_counted(tmp_path: Path) -> None:
    """Each may have tens of thousands of lines, and a small archive thousands of models."""
    write_models(tmp_path, {f"sparse/{number}": 3 if number == 16 else 2 for number in range(17)}, text=True)
    for images in tmp_path.rglob("images.txt"):
        images.write_text("".join(line for line in images.read_text().splitlines(True) if not line.startswith("#")))
    assert open_capture(tmp_path).choose(ViewSelection()).selection["cameras"] == "sparse/0/images.txt"
    first = tmp_path / "sparse/0/images.txt"
    first.write_text("# Number of images: 2\n" + first.read_text())
    assert open_capture(tmp_path).choose(ViewSelection()).selection["cameras"] == "sparse/16/images.txt"


def test_each_model_is_counted_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is read of a zip is limited in all."""
    write_models(tmp_path, {"sparse/0": 2, "sparse/1": 3, "colmap/sparse/0": 2}, text=True)
    for images in tmp_path.rglob("images.txt"):
        images.write_text("".join(line for line in images.read_text().splitlines(True) if not line.startswith("#")))
    counted, count = [], colmap_models.read_images
    monkeypatch.setattr(colmap_models, "read_images", lambda stream, path: counted.append(path) or count(stream, path))
    assert open_capture(tmp_path).table.source == "sparse/1/images.txt"
    assert counted == ["sparse/0/images.txt", "sparse/1/images.txt"]


def test_where_its_images_cannot_be_counted_the_first_stays(tmp_path: Path) -> None:
    """Then it is refused by its line, and not passed over."""
    write_models(tmp_path, {"sparse/0": 2, "sparse/1": 3}, text=True)
    (tmp_path / "sparse/0/images.txt").write_text("1 2\n")
    with pytest.raises(CameraError, match=r"sparse/0/images.txt, line 1"):
        open_capture(tmp_path)


@pytest.mark.parametrize(("others", "more"), [(7, ", 2 more"), (5, "")])
def test_many_models_are_counted(tmp_path: Path, others: int, more: str) -> None:
    write_models(tmp_path, {"sparse": 2} | {f"colmap/sparse/{index}": 2 for index in range(others)})
    (notice,) = open_capture(tmp_path).table.warnings
    assert f"{others + 1} COLMAP models are there: sparse (2 images) is read" in notice["message"]
    assert f"colmap/sparse/4 (2 images){more} (for" in notice["message"]


@pytest.mark.parametrize("data", [b"", b"\1\0\0", b"\xff" * 8])
def test_a_model_that_is_not_read_may_be_damaged(tmp_path: Path, data: bytes) -> None:
    write_models(tmp_path, {"sparse/0": 2, "sparse/1": 2})
    (tmp_path / "sparse/1/images.bin").write_bytes(data)
    (notice,) = open_capture(tmp_path).table.warnings
    assert "ignored: sparse/1 (for another" in notice["message"]


def test_a_text_that_is_not_read_may_be_damaged(tmp_path: Path) -> None:
    write_models(tmp_path, {"sparse/0": 2, "sparse/1": 3}, text=True)
    (tmp_path / "sparse/1/images.txt").write_text("1 2\n")
    (notice,) = open_capture(tmp_path).table.warnings
    assert "sparse/0 (2 images) is read; ignored: sparse/1 (for another" in notice["message"]


def test_a_model_that_is_not_read_may_be_damaged_in_its_zip(tmp_path: Path) -> None:
    write_models(tmp_path / "scene", {"sparse/0": 2, "sparse/1": 3})
    name, data = b"sparse/1/images.bin", bytearray(zipped(tmp_path / "scene"))
    data[data.index(name) + len(name)] = 0xFF  # no block of deflated bytes begins so
    (tmp_path / "scene.zip").write_bytes(data)
    (notice,) = open_capture(tmp_path / "scene.zip").table.warnings
    assert "sparse/0 (2 images) is read; ignored: sparse/1 (for another" in notice["message"]


@pytest.mark.parametrize("folder", ["sparse/1", "sparse", "colmap/sparse/3", "colmap/sparse"])
def test_a_named_model_has_the_photographs_of_its_project(
    tmp_path: Path, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_models(tmp_path, {folder: 3, "sparse/0": 2})
    inside, named = tmp_path / folder, Path(folder)
    for path in (inside / "images.bin", named / "cameras.bin", named, Path("images.bin"), Path()):
        monkeypatch.chdir(tmp_path if path.is_relative_to(named) else inside)
        found = open_capture(path).choose(ViewSelection())
        assert found.selection["cameras"] == f"{folder}/images.bin"
        assert found.paths == tuple(f"images/{name}" for name in names(3))
        assert found.warnings == ()
        assert found.read(1)


def test_a_named_model_with_photographs_beside_it_keeps_them(tmp_path: Path) -> None:
    write_models(tmp_path, {"sparse/0": 2})
    (tmp_path / "images").rename(tmp_path / "sparse/0/images")
    found = open_capture(tmp_path / "sparse/0/images.bin").choose(ViewSelection())
    assert found.paths == tuple(f"images/{name}" for name in names(2))


def test_a_single_model_is_not_talked_about(tmp_path: Path) -> None:
    write_models(tmp_path, {"sparse/0": 2})
    (tmp_path / "sparse/1").mkdir()
    assert open_capture(tmp_path).choose(ViewSelection()).warnings == ()


def test_a_project_may_be_called_colmap(tmp_path: Path) -> None:
    """As nerfstudio calls the folder of its models, which has no photographs."""
    project = tmp_path / "colmap"
    write_models(project, {"sparse/0": 3})
    for path in (project, project / "sparse/0/images.bin", project / "sparse/0", project / "sparse"):
        assert open_capture(path).choose(ViewSelection()).paths == tuple(f"images/{name}" for name in names(3))
    for path in (project / "images").iterdir():
        path.rename(project / path.name)
    (project / "images").rmdir()
    assert open_capture(project).choose(ViewSelection()).paths == tuple(names(3))


@pytest.mark.parametrize("place", ["sparse", "colmap/sparse"])
def test_in_the_folder_of_the_models_the_largest_is_read_too(tmp_path: Path, place: str) -> None:
    write_models(tmp_path, {f"{place}/0": 2, f"{place}/1": 3, f"{place}/10": 2})
    found = open_capture(tmp_path / place).choose(ViewSelection())
    assert found.selection["cameras"] == f"{place}/1/images.bin"
    assert found.paths == tuple(f"images/{name}" for name in names(3))
    (notice,) = found.warnings
    assert "3 COLMAP models are there: 1 (3 images) is read; ignored: 0 (2 images), 10 (2 images)" in notice["message"]


def test_a_folder_that_holds_more_than_numbered_models_stays_refused(tmp_path: Path) -> None:
    write_models(tmp_path, {"sparse/0": 2, "sparse/own": 3})
    with pytest.raises(CaptureError, match="holds 2 captures: 0, own"):
        open_capture(tmp_path / "sparse")


def test_the_folder_of_a_single_model_stands_for_it(tmp_path: Path) -> None:
    write_models(tmp_path, {"sparse/4": 3})
    found = open_capture(tmp_path / "sparse").choose(ViewSelection())
    assert found.selection["cameras"] == "sparse/4/images.bin"
    assert found.paths == tuple(f"images/{name}" for name in names(3))


@pytest.mark.parametrize(("missing", "text"), [("images", False), ("cameras", True)])
@pytest.mark.parametrize("folder", ["", "project/"])
def test_a_model_that_lacks_a_file_is_named_with_it(tmp_path: Path, missing: str, text: bool, folder: str) -> None:
    write_colmap(tmp_path / folder, arc(2), "sparse/1", text=text)
    form = "txt" if text else "bin"
    (tmp_path / folder / f"sparse/1/{missing}.{form}").unlink()
    there = {"images": "cameras", "cameras": "images"}[missing]
    told = f"no whole COLMAP model: {folder}sparse/1/{there}.{form} is there without {missing}.{form} beside it"
    with pytest.raises(CaptureError, match=told) as caught:
        open_capture(tmp_path)
    assert caught.value.cure == "copy or export the model with all its files"
