"""Runs in a separate process that are killed as soon as their folder has a state to resume from."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

from gapmes.model.training import run_folder


def killed_with_a_state(run: Callable[[Path], None], folder: Path, *, daemon: bool = True) -> None:
    """Killed by SIGKILL; `daemon` if the run itself starts no processes."""
    child = get_context("spawn").Process(target=run, args=(folder,), daemon=daemon)
    child.start()
    until = time.monotonic() + 300
    while not (folder / run_folder.STATE).is_file():
        assert child.is_alive()
        assert time.monotonic() < until
        time.sleep(0.001)
    child.kill()
    child.join()
    assert child.exitcode == -signal.SIGKILL
