"""Whether a process is alive, also where orphans are not reaped, and waiting for a condition."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return not _finished(pid)


def _finished(pid: int) -> bool:
    """Ended but not reaped: orphans stay so if nobody reaps them."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):  # reaped meanwhile, unless the system has no such files
        return Path("/proc/self/stat").exists()
    return stat.rpartition(")")[2].split()[0] == "Z"


def wait_for(condition: Callable[[], object], seconds: float = 120) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
