"""`gapmes render` of a file of Gaussians without cameras: one camera in front of the scene, as for a loaded file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import assert_refusal, run
from clouds import cloud
from http_requests import camera_object
from PIL import Image

from gapmes.service.formats.registry import FORMATS
from gapmes.service.splat import render
from gapmes.service.viewpoints.default_framing import default_views


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.ply"
    path.write_bytes(FORMATS["ply"].write(cloud(400, 3)).data)
    return path


def test_the_picture_is_that_of_the_default_camera(scene: Path) -> None:
    assert run("render", scene, "-o", scene.parent / "out", "--threads", 1, "--json") == 0
    views = default_views(cloud(400, 3))
    assert views.near is not None
    expected = render(cloud(400, 3), views.cameras[0], near=0.1 * views.near, threads=1).rgb8()
    found = np.asarray(Image.open(scene.parent / "out" / "view_0.png"))
    assert found.shape == (512, 512, 3)
    assert np.abs(found.astype(int) - expected).max() <= 1
    assert expected.max() > 50


def test_orbits_and_sizes_are_about_it(scene: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = scene.parent / "out"
    assert run("render", scene, "-o", out, "--views", "0,orbit:40", "--size", "96x64", "--threads", 1) == 0
    pictures = {path.name: np.asarray(Image.open(path)) for path in out.iterdir()}
    assert {picture.shape for picture in pictures.values()} == {(64, 96, 3)}
    assert len(pictures) == 2
    assert len({picture.tobytes() for picture in pictures.values()}) == 2
    assert run("render", scene, "-o", scene.parent / "film.webp", "--seconds", 0.5, "--size", "48x48") == 0
    capfd.readouterr()
    assert run("render", scene, "-o", out, "--views", "1", "--json") == 1
    assert_refusal(capfd, "views")


def test_what_cannot_be_written_is_refused_before_it_is_read(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("gapmes.service.formats.registry.inspect_gaussians", None)
    assert run("render", scene, "-o", scene.parent / "picture.png", "--json") == 1
    assert_refusal(capfd, "pictures go into a folder")


def test_a_file_without_gaussians_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    empty = cloud(4, 3)[np.zeros(4, bool)]
    (tmp_path / "empty.ply").write_bytes(FORMATS["ply"].write(empty).data)
    assert run("render", tmp_path / "empty.ply", "-o", tmp_path / "out", "--json") == 1
    assert_refusal(
        capfd, "scene: 0 Gaussians, need at least 1 for a camera to look at (is it the right file, and whole?)"
    )
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps(camera_object(1)))
    assert run("render", tmp_path / "empty.ply", "--cameras", cameras, "-o", tmp_path / "out") == 0
    told = "none of 0 Gaussians is drawn (view 0: there are none; is it the right file, and whole?)"
    assert told in capfd.readouterr().err
