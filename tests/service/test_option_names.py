"""A refusal of a command names the option or argument that it is about."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runs import assert_refusal, run
from clouds import cloud

from gapmes.service import write_ply


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_ply(tmp_path / "scene.ply", cloud(20, 1))
    return tmp_path / "scene.ply"


@pytest.mark.parametrize("kind", ["missing", "empty"])
def test_an_option_with_a_capture_is_named(kind: str, scene: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = scene.parent / kind
    if kind == "empty":
        folder.mkdir()
    words = "does not exist" if kind == "missing" else "is empty"
    assert run("render", scene, "--cameras", folder, "-o", scene.parent / "out", "--json") == 1
    assert assert_refusal(capfd, f"cameras: {folder} {words}")["field"] == "cameras"
    assert run("convert", scene, scene.parent / "a.spz", "--measure", folder, "--json") == 1
    assert assert_refusal(capfd, f"measure: {folder} {words}")["field"] == "measure"
    assert run("reconstruct", folder, "-o", scene.parent / "a.ply", "--json") == 1
    assert assert_refusal(capfd, f"capture: {folder} {words}")["field"] == "capture"


def test_the_format_of_the_input_is_refused_as_from(scene: Path, capfd: pytest.CaptureFixture[str]) -> None:
    sample = Path(__file__).parents[2] / "service/assets/sample"
    for command in (
        ("convert", scene, scene.parent / "a.spz"),
        ("render", scene, "--cameras", sample, "-o", scene.parent / "out"),
    ):
        assert run(*command, "--from", "nope", "--json") == 1
        assert assert_refusal(capfd, "from: 'nope' is no format of Gaussians")["field"] == "from"
