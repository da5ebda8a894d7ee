"""`gapmes reconstruct`: its files and messages, its choice of views, and its refusals."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, write_colmap, write_transforms, zipped
from cli_runs import assert_refusal, reconstruct, run
from PIL import Image

from gapmes.service import read_ply
from gapmes.service.formats.registry import inspect_gaussians
from gapmes.service.kernels import warm_up


def test_reconstruct_and_render(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    warm_up.cache_clear()  # as in a process of its own
    assert reconstruct(scene_dir, standin_model, "--views", "0,2", "--json") == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    assert document["selected_views"] == [0, 2]
    assert document["gaussians"]["count"] == len(read_ply(scene_dir / "out.ply"))
    for stage in (
        "load model",
        "kernels",
        "read images",
        "cameras",
        "images",
        "network",
        "gaussians",
        "fade",
        "leave out",
        "check",
        "write",
    ):
        assert re.search(rf"^{re.escape(stage)} +\d+\.\d\d s$", err, re.MULTILINE), err

    cameras = scene_dir / "cameras.json"
    out_dir = scene_dir / "views"
    arguments = ("render", scene_dir / "out.ply", "--cameras", cameras, "-o", out_dir, "--threads", 1)
    assert run(*arguments, "--views", "1,2.5", "--json") == 0
    written = json.loads(capfd.readouterr().out)["views"]
    assert [(entry["view"], entry["width"], entry["height"]) for entry in written] == [("1", 64, 48), ("2.5", 64, 48)]
    assert sorted(path.name for path in out_dir.iterdir()) == ["view_1.png", "view_2.5.png"]

    assert run(*arguments, "--crop", "square", "--size", "32x32", "--views", "3") == 0
    assert Image.open(out_dir / "view_3.png").size == (32, 32)
    assert capfd.readouterr().out == ""


def test_fading_is_as_asked_for(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for asked, said in (
        ((), "fading in 4 passes: "),
        (("--fade", 1), "fading in 1 pass: "),
        (("--fade", 0), "fading: off"),
    ):
        assert reconstruct(scene_dir, standin_model, "--views", "0,1", *asked) == 0
        assert said in capfd.readouterr().err
    assert reconstruct(scene_dir, standin_model, "--views", "0,1", "--fade", 9) == 1
    assert "fade: is 9, need a whole number from 0 to 8" in capfd.readouterr().err


def test_detail_is_as_asked_for(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1", "--detail", 2, "--json") == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    assert document["detail"] == 2
    assert [(view["width"], view["height"]) for view in document["view_cameras"]] == [(128, 96)] * 2
    assert "warning: view 0: the photograph has 64 px where a row of the scene" in err
    assert reconstruct(scene_dir, standin_model, "--views", "0,1", "--detail", 2, "--stride", 2) == 1
    assert "detail: is 2 beside stride 2" in capfd.readouterr().err


def test_reconstruction_is_the_same_twice(scene_dir: Path, standin_model: Path) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    first = (scene_dir / "out.ply").read_bytes()
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    assert (scene_dir / "out.ply").read_bytes() == first


def test_transforms_json_without_sizes(scene_dir: Path, standin_model: Path) -> None:
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 0
    expected = (scene_dir / "out.ply").read_bytes()
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = json.loads((scene_dir / "cameras.json").read_text())
    frames = [
        {"file_path": view["image"], "transform_matrix": (np.array(view["c2w"]) @ flip).tolist()}
        for view in cameras["views"]
    ]
    (scene_dir / "cameras.json").unlink()
    (scene_dir / "transforms.json").write_text(json.dumps({"fl_x": 60.0, "frames": frames}))
    assert reconstruct(scene_dir, standin_model, "--views", "0,1", "--near", 1, "--far", 10) == 0
    assert (scene_dir / "out.ply").read_bytes() == expected


def test_a_zip_and_a_folder_are_the_same_scene(
    scene_dir: Path, tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """By names or by indices; the answer says what was used, of what."""
    assert reconstruct(scene_dir, standin_model, "--views", "0,2") == 0
    expected = (scene_dir / "out.ply").read_bytes()
    (scene_dir / "out.ply").unlink()
    packed = tmp_path / "capture.zip"
    packed.write_bytes(zipped(scene_dir, inside="scene/"))
    arguments = ("--model", standin_model, "--threads", 1, "-o", tmp_path / "out.ply", "--json")
    capfd.readouterr()
    for views in ("0,2", "000.png,images/002.png"):
        assert run("reconstruct", packed, *arguments, "--views", views) == 0
        assert (tmp_path / "out.ply").read_bytes() == expected
        out, err = capfd.readouterr()
        assert json.loads(out)["selection"] == {
            "by": "select",
            "format": "cameras.json",
            "cameras": "scene/cameras.json",
            "of": 4,
            "views": [0, 2],
            "images": ["scene/images/000.png", "scene/images/002.png"],
        }
        assert "views 0, 2 of 4 in scene/cameras.json (cameras.json): as asked for" in err


def test_of_many_views_some_are_chosen(tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """COLMAP's model of nine photographs, of which three are used, or as many as are asked for."""
    (tmp_path / "scene").mkdir()
    write_colmap(tmp_path / "scene", arc(9))
    more = ("--near", 2, "--far", 8, "--trust-poses", "--leave-one-out", 0, "--json")
    for asked, count in (((), 3), (("--context", 2), 2), (("--context", 4), 4)):
        assert reconstruct(tmp_path / "scene", standin_model, *asked, *more) == 0
        out, err = capfd.readouterr()
        document = json.loads(out)
        assert len(document["selected_views"]) == len(document["cameras"]) == count
        said = document["selection"]
        assert (said["by"], said["of"], said["compared"], said["format"]) == ("score", 9, 9, "colmap")
        assert said["views"] == document["selected_views"]
        assert f"of 9 in sparse/0/images.bin (colmap): chosen for overlap ({said['overlap']:.0%})" in err


def test_photographs_through_a_lens_are_resampled(
    tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene").mkdir()
    write_transforms(tmp_path / "scene", arc(2))
    path = tmp_path / "scene" / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"k1": -0.1}))
    more = ("--near", 2, "--far", 8, "--trust-poses", "--json")
    assert reconstruct(tmp_path / "scene", standin_model, *more) == 0
    out, err = capfd.readouterr()
    document = json.loads(out)
    width, height = (document["cameras"][0][name] for name in ("width", "height"))
    told = [warning for warning in document["warnings"] if warning["code"] == "undistorted"]
    assert [warning["index"] for warning in told] == [0, 1]
    assert f"resampled to a pinhole of {width} x {height} px, which shows 9" in told[0]["message"]
    assert (width, height) != (96, 72)
    assert told[1]["message"] in err


def test_views_that_are_not_wanted_need_no_photograph(scene_dir: Path, standin_model: Path) -> None:
    (scene_dir / "images" / "001.png").unlink()
    assert reconstruct(scene_dir, standin_model, "--views", "0,2") == 0
    assert reconstruct(scene_dir, standin_model, "--views", "0,1") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--views", "0,9"), "view 9 does not exist"),
        (("--views", "0"), "views: 1 view, need 2 to 6"),
        (("--views", "0,0"), "given twice"),
        (("--views", "a,b"), "is not a view index, nor the name of a view"),
        (("--views", "0,1", "--context", "3"), "context: is given beside views"),
        (("--context", "7"), "context: 7 views, need 2 to 6"),
        (("--near", "5", "--far", "2"), "near"),
        (("--model", "missing.onnx"), "missing.onnx"),
    ],
)
def test_refusals_of_reconstruct(
    scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    if not {"--views", "--context"} & set(arguments):
        arguments = (*arguments, "--views", "0,1")
    assert reconstruct(scene_dir, standin_model, *arguments, "--json") == 1
    assert_refusal(capfd, words)
    assert not (scene_dir / "out.ply").exists()


def test_image_that_is_none(scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (scene_dir / "images" / "002.png").write_text("no image")
    assert reconstruct(scene_dir, standin_model, "--views", "0,2", "--json") == 1
    assert assert_refusal(capfd, "view 2")["code"] == "image_unreadable"


@pytest.mark.parametrize("extension", ["spz", "compressed.ply", "splat"])
def test_the_output_has_the_format_of_its_name(
    extension: str, scene_dir: Path, standin_model: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / f"scene.{extension}"
    assert reconstruct(scene_dir, standin_model, "--views", "0,2", "-o", output, "--json") == 0
    document = json.loads(capfd.readouterr().out)
    assert (document["file"], document["format"]) == (str(output), extension)
    reading, found = inspect_gaussians(output)
    assert found.extension == extension
    assert len(reading.gaussians) == document["gaussians"]["count"]
    assert not (scene_dir / "out.ply").exists()


def test_an_unknown_format_is_refused_before_the_work(
    scene_dir: Path, standin_model: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(scene_dir, standin_model, "-o", tmp_path / "x.obj", "--json") == 1
    assert_refusal(capfd, "output: 'x.obj' ends in none of ply, compressed.ply, splat, spz")


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("missing/out.ply", "missing is not a folder (make it first)"),
        ("folder.ply", "folder.ply is a folder, need a file (name a file in it)"),
    ],
)
def test_where_no_file_can_be_is_said_before_the_work(
    scene_dir: Path, output: str, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (scene_dir / "folder.ply").mkdir()
    assert reconstruct(scene_dir, scene_dir / "no_model.onnx", "-o", scene_dir / output, "--json") == 1
    assert assert_refusal(capfd, words)["field"] == "output"


def test_a_folder_without_permission_is_said_before_the_work(
    scene_dir: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of a link it is the folder of the file behind it, of a pipe the pipe."""
    (scene_dir / "elsewhere").mkdir()
    (scene_dir / "link.ply").symlink_to(scene_dir / "elsewhere" / "out.ply")
    os.mkfifo(scene_dir / "pipe.ply")
    asked: list[Path] = []

    def access(path: Path, mode: int) -> bool:
        if not mode & os.W_OK:  # of what is read
            return True
        asked.append(Path(path))
        return False

    monkeypatch.setattr(os, "access", access)
    for name in ("out.ply", "link.ply", "pipe.ply"):
        assert reconstruct(scene_dir, scene_dir / "no_model.onnx", "-o", scene_dir / name, "--json") == 1
        error = assert_refusal(capfd, f"{name} cannot be written: no permission (choose another folder")
        assert (error["code"], error["field"]) == ("invalid_input", "output")
    assert asked == [scene_dir.resolve(), (scene_dir / "elsewhere").resolve(), scene_dir / "pipe.ply"]


def test_models_that_were_passed_over_are_told(
    tmp_path: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene").mkdir()
    write_colmap(tmp_path / "scene", arc(2))
    write_colmap(tmp_path / "scene", arc(3), "sparse/1")
    more = ("--near", 2, "--far", 8, "--trust-poses", "--leave-one-out", 0, "--json")
    assert reconstruct(tmp_path / "scene", standin_model, *more) == 0
    out, err = capfd.readouterr()
    (told,) = [warning for warning in json.loads(out)["warnings"] if warning["code"] == "several_models"]
    assert "such as sparse/0/images.bin" in told["message"]
    assert f"warning: {told['message']}" in err
    arguments = ("--model", standin_model, "--threads", 1, "-o", tmp_path / "out.ply")
    assert run("reconstruct", tmp_path / "scene/sparse/0/images.bin", *arguments, *more) == 0
    document = json.loads(capfd.readouterr().out)
    assert (len(document["cameras"]), document["selection"]["cameras"]) == (2, "sparse/0/images.bin")
    assert not any(warning["code"] == "several_models" for warning in document["warnings"])


def test_a_refusal_names_the_view_as_the_capture_counts_it(
    scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(np.zeros((64, 48, 3), np.uint8)).save(scene_dir / "images" / "003.png")
    assert reconstruct(scene_dir, standin_model, "--views", "1,3", "--json") == 1
    error = assert_refusal(capfd, "error: view 3: images: the photograph is 48 x 64 px")
    assert error["index"] == 3


def test_swapped_depths_are_refused_before_the_network_is_loaded(
    scene_dir: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(scene_dir, standin_model, "--near", 8, "--far", 2) == 1
    error = capfd.readouterr().err
    assert "near = 8, far = 2, need near < far (are they swapped" in error
    assert "load model" not in error
