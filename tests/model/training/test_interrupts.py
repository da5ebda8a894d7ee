"""The interrupt of a terminal reaches all processes of a command, and one line tells of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from test_scenes_ahead import _drawing, _eventually, _gone


def _blocks_interrupts(pid: int) -> bool:
    status = dict(line.split(":\t") for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return bool(int(status["SigBlk"], 16) & 1 << (signal.SIGINT - 1))


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (
            ["gapmes.model.training", "run", "--device", "cpu"],
            "stopped; the same command goes on from the last state\n",
        ),
        (["gapmes.model.training.choice", "choice.npz"], "stopped; nothing is kept\n"),
    ],
)
def test_processes_that_begin_tell_nothing_of_an_interrupt(command: list[str], told: str, tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", *command, "--processes", "2", "--steps", "60", "--quiet"],
        cwd=tmp_path,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background shell has it ignored
    ) as run:
        _eventually(lambda: len(_drawing(run.pid)) == 2)
        processes = _drawing(run.pid)
        blocked = all(map(_blocks_interrupts, processes))  # or one that imports would end in a traceback
        _eventually(lambda: all("libtorch" in Path(f"/proc/{process}/maps").read_text() for process in processes))
        os.killpg(run.pid, signal.SIGINT)
        _, heard = run.communicate(timeout=120)
    _eventually(lambda: all(map(_gone, processes)))
    assert blocked
    assert (run.returncode, heard) == (130, told)
    assert not (tmp_path / "choice.npz").exists()
