"""Which scenes `python -m benchmarks.load.faults` takes as complete, and which as partial."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(
    ("files", "whole"),
    [
        (("scene.ply", "scene.json", "input_0.png", "input_1.png"), True),
        (("scene.ply", "scene.json", "input_0.png"), False),
        (("scene.ply", "scene.json", "input_1.png"), False),
        (("scene.ply", "scene.json", "input_0.png", "input_2.png"), False),
        (("scene.ply", "scene.json", "input_0.png", "input_1.png", "input_2.png"), False),
        (("scene.ply", "scene.json", "input_0.png", "input_1.png", "other"), False),
        (("scene.json", "input_0.png", "input_1.png"), False),
        (("scene.ply", "input_0.png", "input_1.png"), False),
        ((), False),
    ],
)
def test_a_scene_is_whole_with_its_inputs_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: tuple[str, ...], whole: bool
) -> None:
    monkeypatch.syspath_prepend(ROOT)
    faults = importlib.import_module("benchmarks.load.faults")
    for name in files:
        (tmp_path / name).write_text('{"inputs": 2}')
    assert faults.whole(tmp_path) == whole
