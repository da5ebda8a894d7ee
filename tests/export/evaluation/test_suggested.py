"""The suggested views of a scene folder: which are used and which are refused, before any work."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from gapmes.export.cli import app as export_app
from gapmes.export.evaluation import run as measuring
from gapmes.export.evaluation import suggested as suggesting
from gapmes.export.evaluation.case import photograph_case
from gapmes.export.evaluation.scene_views import SUGGESTED, scene_views
from gapmes.export.evaluation.suggested import NoSuchViews
from gapmes.export.tradeoff import files
from gapmes.service import cli
from gapmes.service.errors import ImageError, InputError
from gapmes.service.shipped import sample_folder

GOOD = {"context2": [1, 5], "target2": [2, 3]}


def scene(folder: Path, **suggested: list[int]) -> Path:
    """The sample, with eight views, and other suggestions."""
    shutil.copytree(sample_folder(), folder)
    path = folder / "cameras.json"
    document = json.loads(path.read_text())
    document["suggested"] = {**GOOD, **suggested}
    path.write_text(json.dumps(document))
    return folder


WRONG = [
    ({"context2": [1, -3], "target2": [5]}, r"suggested\.context2\[1\]: .* is -3, the scene has 8 views: need 0 to 7"),
    ({"target2": [2, 3, 8]}, r"suggested\.target2\[2\]: .* is 8, the scene has 8 views: need 0 to 7"),
    ({"target2": [-1]}, r"suggested\.target2\[0\]: .* is -1, the scene has 8 views"),
    ({"target2": [2, 3, 2]}, r"suggested\.target2\[2\]: .* is 2, as target2\[0\] is"),
    ({"context2": [1, 1]}, r"suggested\.context2\[1\]: .* is 1, as context2\[0\] is"),
    ({"context2": [1, 5, 6]}, r"suggested\.context2: .* = \[1, 5, 6\] names 3 views, need 2"),
    ({"context2": [1]}, r"suggested\.context2: .* = \[1\] names 1 view, need 2"),
    ({"target2": [3, 5, 1]}, r"1, 5 both in context2 = \[1, 5\] and target2 = \[3, 5, 1\].*held out"),
]


@pytest.mark.parametrize(("suggested", "words"), WRONG)
def test_views_that_cannot_be_measured_are_refused(tmp_path: Path, suggested: dict[str, list[int]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        photograph_case(scene(tmp_path / "scene", **suggested), 2, 64, 64)


def test_what_is_suggested_is_taken(tmp_path: Path) -> None:
    found = scene_views(sample_folder(), 3)
    assert (found.inputs.indices, found.targets.indices, found.by) == ((0, 3, 7), (1, 2, 5, 6), SUGGESTED)
    edges = scene_views(scene(tmp_path / "scene", context2=[0, 7]), 2)  # the first and the last there is
    assert (edges.inputs.indices, edges.targets.indices) == ((0, 7), (2, 3))
    file = scene_views(tmp_path / "scene" / "cameras.json", 2)
    assert (file.inputs.paths, file.targets.paths) == (edges.inputs.paths, edges.targets.paths)


def test_a_folder_without_suggested_views_is_named(tmp_path: Path) -> None:
    with pytest.raises(NoSuchViews, match="context6"):
        photograph_case(sample_folder(), 6, 64, 64)
    with pytest.raises(NoSuchViews, match="target2"):
        scene_views(scene(tmp_path / "scene", target2=[]), 2)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"is empty.*COLMAP model"):
        photograph_case(tmp_path / "empty", 2, 64, 64)


def test_suggestions_of_a_zip_a_folder_below_and_a_file_of_another_name_are_taken(tmp_path: Path) -> None:
    folder = scene(tmp_path / "up" / "scene")
    with zipfile.ZipFile(tmp_path / "scene.zip", "w") as archive:
        for path in sorted(each for each in folder.rglob("*") if each.is_file()):
            archive.write(path, path.relative_to(folder))
    shutil.copytree(folder, tmp_path / "named")
    (tmp_path / "named" / "cameras.json").rename(tmp_path / "named" / "views.json")
    for path in (tmp_path / "scene.zip", tmp_path / "up", tmp_path / "named" / "views.json"):
        found = scene_views(path, 2)
        assert (found.by, found.inputs.indices, found.targets.indices) == (SUGGESTED, (1, 5), (2, 3))


def test_a_target_with_the_photograph_of_an_input_is_refused(tmp_path: Path) -> None:
    folder = scene(tmp_path / "scene")
    document = json.loads((folder / "cameras.json").read_text())
    document["views"][3]["image"] = document["views"][5]["image"]
    (folder / "cameras.json").write_text(json.dumps(document))
    with pytest.raises(ImageError, match=r"005\.png is the photograph of view 5, an input, too") as caught:
        scene_views(folder, 2)
    assert caught.value.index == 3


@pytest.mark.parametrize("link", [False, True])
def test_a_target_that_equals_an_input_to_the_byte_is_refused(tmp_path: Path, link: bool) -> None:
    """A copy under another name, or a link: nothing would be held out."""
    folder = scene(tmp_path / "scene")
    target, of_input = folder / "images" / "003.png", folder / "images" / "005.png"
    target.unlink()
    if link:
        target.symlink_to(of_input)
    else:
        shutil.copy(of_input, target)
    with pytest.raises(ImageError, match=r"003\.png is the photograph of view 5, an input, too"):
        scene_views(folder, 2)


def test_a_capture_of_a_short_name_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a").mkdir()
    (tmp_path / "a" / "transforms.json").write_text("{bad")
    with pytest.raises(InputError, match=r"^cameras: a: transforms\.json is not"):
        scene_views(Path("a"), 2)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32-be"])
def test_cameras_are_read_in_every_encoding_of_json(tmp_path: Path, encoding: str) -> None:
    path = scene(tmp_path / "scene") / "cameras.json"
    path.write_bytes(path.read_text().encode(encoding))
    assert scene_views(path.parent, 2).targets.indices == (2, 3)


def test_json_that_is_too_deep_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cameras.json"
    path.write_text("[" * 100_000 + "]" * 100_000)
    with pytest.raises(InputError, match=r"cameras\.json is no JSON: "):
        scene_views(tmp_path, 2)
    monkeypatch.setattr(suggesting, "MAX_CAMERA_BYTES", 1000)
    with pytest.raises(InputError, match="200000 bytes or more, the limit is 1000"):
        scene_views(tmp_path, 2)


def see_through(path: Path, width: int) -> None:
    """An alpha channel that is 0 in the first columns and 255 in the others."""
    with Image.open(path) as image:
        image.putalpha(255)
        image.paste((255, 0, 255, 0), (0, 0, width, image.height))
        image.save(path)


@pytest.mark.parametrize("view", [1, 3], ids=["input", "target"])
def test_a_photograph_with_transparent_pixels_is_refused(tmp_path: Path, view: int) -> None:
    """Masked pixels are not part of a scene, but would be compared; opaque alpha masks nothing."""
    folder = scene(tmp_path / "scene")
    opaque, picture = (folder / "images" / f"{number:03d}.png" for number in (5, view))
    see_through(opaque, 0)
    photograph_case(folder, 2, 64, 64)
    see_through(picture, 3)
    with pytest.raises(
        ImageError, match=r"\.png is transparent in 768 of 65536 pixels, need 0.*without an alpha"
    ) as caught:
        photograph_case(folder, 2, 64, 64)
    assert (caught.value.field, caught.value.index) == ("images", view)


def test_evaluate_refuses_a_masked_scene_before_it_loads_a_model(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measuring, "load_models", None)
    late = scene(tmp_path / "late")
    see_through(late / "images" / "003.png", 3)
    with pytest.raises(SystemExit) as end:
        cli.main(["evaluate", str(sample_folder()), str(late), "--inputs", "2", "--out", str(tmp_path / "out")])
    assert end.value.code == 1
    (line,) = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert f"view 3: images: {late / 'images' / '003.png'} is transparent" in line
    assert not (tmp_path / "out").exists()


def test_evaluate_refuses_a_later_scene_before_it_loads_a_model(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measuring, "load_models", None)
    late = scene(tmp_path / "late", target2=[8])
    with pytest.raises(SystemExit) as end:
        cli.main(["evaluate", str(sample_folder()), str(late), "--inputs", "2", "--out", str(tmp_path / "out")])
    assert end.value.code == 1
    (line,) = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert "the scene has 8 views: need 0 to 7" in line
    assert not (tmp_path / "out").exists()


def test_the_report_refuses_a_later_scene_before_it_exports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "all_files", None)
    late = scene(tmp_path / "late", target2=[8])
    arguments = ["--report", str(tmp_path / "out"), "--scene", str(late)]
    result = CliRunner().invoke(export_app, arguments, env={"COLUMNS": "200"})
    assert result.exit_code == 1
    assert "refused: suggested.target2[0]: " in result.output
    assert not (tmp_path / "out").exists()
