"""Runs of the command `gapmes` in tests: the exit code, and the form of a refusal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gapmes.service import cli


def run(*arguments: object) -> int:
    """Run `gapmes` with these arguments; returns its exit code."""
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def reconstruct(scene_dir: Path, model: Path, *more: object) -> int:
    return run("reconstruct", scene_dir, "--model", model, "--threads", 1, "-o", scene_dir / "out.ply", *more)


def assert_refusal(capfd: pytest.CaptureFixture[str], words: str) -> dict[str, Any]:
    """One line on stderr, no traceback, and the problem as JSON on stdout."""
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, err
    assert words in lines[0]
    assert "Traceback" not in err
    error = json.loads(out)["error"]
    assert error["code"]
    assert error["detail"]
    return error
