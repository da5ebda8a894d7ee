"""Runs of `gapmes evaluate` in the test's own process."""

from __future__ import annotations

import pytest

from gapmes.service import cli


def run(*arguments: object) -> int:
    """Run `gapmes evaluate`; returns its exit code."""
    try:
        cli.main(["evaluate", *[str(argument) for argument in arguments], "--threads", "1"])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def refused(capfd: pytest.CaptureFixture[str], words: str) -> None:
    """Run a command that is refused; returns its one line on stderr."""
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert words in lines[0]
