"""Commands whose processes a test watches: started as in a terminal, listed, and looked at until they have ended."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path


def in_a_terminal(command: list[str], folder: Path) -> subprocess.Popen[str]:
    """Start a command in `folder`, in a process group of its own, which an interrupt reaches as a whole."""
    return subprocess.Popen(
        command,
        cwd=folder,
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background shell has it ignored
    )


def spawned(pid: int) -> list[int]:
    """The child processes that `multiprocessing` spawned to work; another one manages what processes share."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text()]


def gone(pid: int) -> bool:
    """Gone, or ended but not reaped: orphans stay so if nobody reaps them."""
    stat = Path(f"/proc/{pid}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z"


def eventually(is_so: Callable[[], bool]) -> None:
    """Wait until it is so, two minutes at most."""
    until = time.monotonic() + 120
    while not is_so():
        assert time.monotonic() < until
        time.sleep(0.01)
