"""Progress on stderr: bars on a terminal, lines elsewhere; and foreign text, without terminal escapes."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run
from ply_cases import binary_file, columns, gaussians
from rich.console import Console

from gapmes.service.formats.ply import ply_bytes
from gapmes.service.process.ending import SIGNALS
from gapmes.service.process.terminal import ProgressBars
from gapmes.service.progress import Stages

# Draws bars, says so on stdout, and waits within them.
DRAWING = """
import os, signal, sys, time
from gapmes.service.process.ending import ended_in_order
from gapmes.service.process.terminal import ProgressBars
signal.signal(int(sys.argv[1]), signal.SIG_DFL)  # under nohup it would be ignored
with ended_in_order(), ProgressBars() as bars:
    os.write(1, b"drawn\\n")  # what is printed would appear above the bars
    for _ in range(12_000):
        time.sleep(0.05)
"""


def test_text_of_strangers_is_shown_and_not_obeyed(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBars() as bars:
        bars.say("a\x1b[2J \x9b31m \u202eb\nü 漢字 [red]")
    assert capfd.readouterr().err == "a\\x1b[2J \\x9b31m \\u202eb ü 漢字 [red]\n"


def test_names_of_strangers_in_errors_are_shown_and_not_obeyed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run("convert", tmp_path / "no\x1b]0;title\x07ne.ply", tmp_path / "out.ply") == 1
    assert "/no\\x1b]0;title\\x07ne.ply is not a file" in capfd.readouterr().err


def test_names_of_properties_are_shown_and_not_obeyed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    table = columns(ply_bytes(gaussians(5))) | {"label\x1b[31m": np.zeros(5, np.float32)}
    (tmp_path / "in.ply").write_bytes(binary_file(table))
    assert run("convert", tmp_path / "in.ply", tmp_path / "out.ply", "--measure", "off", "--json") == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["warnings"] == ["properties ignored: label\\x1b[31m"]
    assert "\x1b" not in err


def test_progress_is_drawn_on_a_terminal_and_written_elsewhere(capfd: pytest.CaptureFixture[str]) -> None:
    for terminal in (True, False):
        console = Console(file=sys.stderr, force_terminal=terminal, width=100, color_system=None)
        with ProgressBars(console) as bars, Stages(bars).stage("network", 4) as step:
            step(2)
        out, err = capfd.readouterr()
        assert out == ""
        assert re.search(r"network.* \d\.\d\d s", err)
        assert ("4/4" in err) == terminal


@pytest.mark.parametrize("ending", SIGNALS)
def test_a_signal_leaves_the_terminal_its_cursor(monkeypatch: pytest.MonkeyPatch, ending: signal.Signals) -> None:
    monkeypatch.setenv("TERM", "xterm")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", DRAWING, str(int(ending))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"drawn\n"
        process.send_signal(ending)
        assert process.wait(120) == -ending
    os.write(theirs, b"end")
    shown = b""
    while not shown.endswith(b"end"):
        shown += os.read(ours, 65536)
    os.close(theirs)
    os.close(ours)
    assert b"\x1b[?25l" in shown
    assert shown.endswith(b"\x1b[?25h\r\nend")
