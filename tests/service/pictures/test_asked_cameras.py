"""`gapmes render` of views whose cameras can be used, in a capture where others cannot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from capture_scenes import arc, write_cameras_json, write_transforms
from cli_runs import assert_refusal, run
from clouds import cloud
from PIL import Image

from gapmes.service.formats.ply import write_ply


@pytest.fixture(params=["fisheye", "skewed pose", "no size"])
def captures(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, Path]:
    """A capture, and the same where view 4 has no camera that can be used."""
    write_ply(tmp_path / "scene.ply", cloud(300, 3, degree=0))
    for name in ("whole", "part"):
        if request.param == "no size":
            write_transforms(tmp_path / name, arc(6))
        else:
            write_cameras_json(tmp_path / name, arc(6))
    changed = tmp_path / "part" / ("transforms.json" if request.param == "no size" else "cameras.json")
    document = json.loads(changed.read_text())
    if request.param == "fisheye":
        document["views"][4]["camera_model"] = "OPENCV_FISHEYE"
    elif request.param == "skewed pose":
        document["views"][4]["c2w"][0][0] += 0.5
    else:
        for entry in (document, *document["frames"]):
            entry.pop("w", None), entry.pop("h", None)
        (tmp_path / "part" / document["frames"][4]["file_path"]).unlink()
    changed.write_text(json.dumps(document))
    return tmp_path / "whole", tmp_path / "part"


def render(capture: Path, output: Path, *more: object) -> int:
    scene = capture.parent / "scene.ply"
    return run("render", scene, "--cameras", capture, "-o", output, "--threads", 1, "-q", "--json", *more)


def test_views_that_do_not_need_it_are_drawn(
    captures: tuple[Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pictures = []
    for capture in captures:
        assert render(capture, tmp_path / f"of {capture.name}", "--views", "5,0,1.25,2") == 0
        written = json.loads(capfd.readouterr().out)
        files = [tmp_path / f"of {capture.name}" / f"view_{view}.png" for view in ("5", "0", "1.25", "2")]
        pictures.append([np.asarray(Image.open(file)) for file in files])
    for one, other in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, other)
    (told,) = [text for text in written["warnings"] if "not asked for" in text]
    assert told.startswith("a camera that is not asked for cannot be used: view 4: ")


@pytest.mark.parametrize("views", ["4", "0,3.5", "0,orbit:10", None])
def test_where_it_is_needed_it_is_refused(
    captures: tuple[Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str], views: str | None
) -> None:
    asked = () if views is None else ("--views", views)
    assert render(captures[1], tmp_path / "pictures", *asked) == 1
    assert_refusal(capfd, "view 4")
    assert not (tmp_path / "pictures").exists()


def test_a_film_is_about_all(captures: tuple[Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert render(captures[1], tmp_path / "film.gif", "--views", "0,1", "--seconds", 0.2) == 1
    assert_refusal(capfd, "view 4")


def test_a_view_that_does_not_exist_is_still_one(captures: tuple[Path, Path], tmp_path: Path) -> None:
    for views in ("9", "-1", "nan", "x"):
        assert render(captures[1], tmp_path / "pictures", "--views", views) == 1
