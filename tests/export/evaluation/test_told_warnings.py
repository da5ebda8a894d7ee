"""What `gapmes evaluate` tells of its captures: warnings of a reconstruction, and depths that are refused at once."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from capture_scenes import arc, write_cameras_json, write_colmap
from evaluate_runs import refused, run
from PIL import Image
from standin_model import METADATA, write_standin

from gapmes.export.evaluation import run as measuring
from gapmes.export.evaluation.scene_views import scene_views


@pytest.fixture
def model(tmp_path: Path) -> Path:
    config = {"config": json.dumps({"sh_degree": 1, "experts": 6})}
    return write_standin(tmp_path / "wide.onnx", {**METADATA, **config})


def turned(path: Path) -> None:
    """Give a picture an EXIF orientation."""
    exif, stored = Image.Exif(), io.BytesIO()
    exif[0x0112] = 3
    Image.open(path).save(stored, "PNG", exif=exif)
    path.write_bytes(stored.getvalue())


def test_warnings_are_told_of_each_scene(tmp_path: Path, capfd: pytest.CaptureFixture[str], model: Path) -> None:
    """Of the capture, of its views and of the scene; and as the scene calls its views."""
    scene, out = tmp_path / "scene", tmp_path / "out"
    write_colmap(scene, arc(7), "sparse/0")
    write_colmap(scene, arc(3), "sparse/1")
    for path in scene.rglob("*.png"):
        turned(path)
    assert run(scene, "--inputs", 2, "--model", model, "--fade", 0, "--out", out) == 0
    (group,) = json.loads((out / "report.json").read_text())["groups"]
    (measured,) = group["scenes"]
    codes = [warning["code"] for warning in measured["warnings"]]
    assert codes[0] == "several_models"
    assert codes.count("exif_orientation_ignored") == 2
    inputs = set(scene_views(scene, 2).inputs.indices)
    of_views = [warning for warning in measured["warnings"] if warning["code"] == "exif_orientation_ignored"]
    assert {warning["index"] for warning in of_views} == inputs != {0, 1}
    told, text = capfd.readouterr().err, (out / "report.md").read_text()
    assert "scene: warning: 2 COLMAP models are there" in told
    assert "- scene: 2 COLMAP models are there" in text
    for index in inputs:
        assert f"scene: warning: view {index}: EXIF orientation 3 is not applied" in told
        assert f"- scene: view {index}: EXIF orientation 3 is not applied" in text


@pytest.mark.parametrize(("near", "far"), [(9.0, 2.0), (2.0, None), (-1.0, 4.0)])
def test_depths_that_are_no_range_are_refused_before_anything_is_measured(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    model: Path,
    near: float,
    far: float | None,
) -> None:
    """What was measured of others would be lost."""
    for name in ("good", "bad"):
        write_cameras_json(tmp_path / name, arc(7))
    path = tmp_path / "bad" / "cameras.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"near": near, "far": far}))
    monkeypatch.setattr(measuring, "measure", lambda *_, **__: pytest.fail("measured"))
    asked = ("--inputs", 2, "--model", model, "--fade", 0, "--out", tmp_path / "out")
    assert run(tmp_path / "good", tmp_path / "bad", *asked) == 1
    refused(capfd, str(tmp_path / "bad"))
