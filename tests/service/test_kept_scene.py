"""A scene that does not fit into the file that was asked for is not lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run
from plyfile import PlyData

AWAY = np.array([532_000.0, 5_410_000.0, 310.0])  # a map's coordinates


@pytest.fixture
def away(scene_dir: Path) -> Path:
    """The capture of `scene_dir`, far from the world's origin."""
    cameras = json.loads((scene_dir / "cameras.json").read_text())
    for view in cameras["views"]:
        for row, shift in zip(view["c2w"], AWAY, strict=False):
            row[3] += float(shift)
    (scene_dir / "cameras.json").write_text(json.dumps(cameras))
    return scene_dir


def reconstruct(folder: Path, model: Path) -> int:
    given = ("--model", model, "--threads", 1, "--views", "0,1", "--near", 1, "--far", 10)
    return run("reconstruct", folder, "-o", folder / "out.spz", *given)


def test_it_is_kept_as_a_ply_that_the_refusal_names(
    away: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert reconstruct(away, standin_model) == 1
    told = capfd.readouterr().err
    assert "farther from the origin" in told
    assert f"the scene is in {away / 'out.spz.ply'}" in told
    vertices = PlyData.read(away / "out.spz.ply")["vertex"]
    assert len(vertices) > 1000
    assert np.abs(np.median(vertices["y"]) - AWAY[1]) < 100
    assert not (away / "out.spz").exists()


def test_a_file_of_that_name_stays(away: Path, standin_model: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (away / "out.spz.ply").write_text("mine")
    assert reconstruct(away, standin_model) == 1
    told = capfd.readouterr().err
    assert "farther from the origin" in told
    assert f"the scene is not kept, since there is a {away / 'out.spz.ply'} already" in told
    assert (away / "out.spz.ply").read_text() == "mine"


def test_a_lack_of_room_does_not_hide_why(
    away: Path, standin_model: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gapmes.service.commands.kept_scene.replace_file", full)
    assert reconstruct(away, standin_model) == 1
    told = capfd.readouterr().err
    assert "farther from the origin" in told
    assert f"{away / 'out.spz.ply'} cannot be written: No space left on device" in told
