"""The interrupt of a terminal reaches all processes of a command, and one line tells of it."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from child_processes import eventually, gone, in_a_terminal, spawned

from gapmes.model.training.command import BEGINS_ANEW


def _blocks_interrupts(pid: int) -> bool:
    status = dict(line.split(":\t") for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return bool(int(status["SigBlk"], 16) & 1 << (signal.SIGINT - 1))


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (
            ["gapmes.model.training", "run", "--device", "cpu"],
            f"stopped; the same command {BEGINS_ANEW}\n",
        ),
        (["gapmes.model.training.choice", "choice.npz"], "stopped; nothing is kept\n"),
    ],
)
def test_processes_that_begin_tell_nothing_of_an_interrupt(command: list[str], told: str, tmp_path: Path) -> None:
    started = [sys.executable, "-m", *command, "--processes", "2", "--steps", "60", "--quiet"]
    with in_a_terminal(started, tmp_path) as run:
        eventually(lambda: len(spawned(run.pid)) == 2)
        processes = spawned(run.pid)
        blocked = all(map(_blocks_interrupts, processes))  # or one that imports would end in a traceback
        eventually(lambda: all("libtorch" in Path(f"/proc/{process}/maps").read_text() for process in processes))
        os.killpg(run.pid, signal.SIGINT)
        _, heard = run.communicate(timeout=120)
    eventually(lambda: all(map(gone, processes)))
    assert blocked
    assert (run.returncode, heard) == (130, told)
    assert not (tmp_path / "choice.npz").exists()
