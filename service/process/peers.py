"""Worker processes that share a port announce that they are loaded, by files in the folder of their metrics."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

FOLDER = "PROMETHEUS_MULTIPROC_DIR"  # variable that names the folder; prometheus_client reads it at import
OURS = "gapmes-metrics-"  # prefix of folders that `gapmes serve` creates, and may delete
COMPLETE = "complete"


class Peers:
    """`count` processes that share `folder`; without one the process is alone.

    The system hands a connection to any process that listens on the port. So that a client never meets an unloaded
    process after the service was ready, it becomes ready only when all processes are loaded. A later replacement of a
    dead process listens only once it is loaded, or while no other is.
    """

    def __init__(self, count: int, folder: Path | None) -> None:
        self.count = count
        self._folder = folder if count > 1 else None
        self._complete = self._folder is None
        self._loaded = False

    @property
    def complete(self) -> bool:
        """Whether all processes were loaded at one time; stays true, even if the folder is deleted."""
        if self._folder is not None and not self._complete:
            self._complete = (self._folder / COMPLETE).exists()
        return self._complete

    @property
    def may_listen_unloaded(self) -> bool:
        """Whether a process should listen before it is loaded: not all were loaded yet, or none is now."""
        return not self.complete or not self.living()

    def announce_loaded(self) -> None:
        """Announce that this process is loaded."""
        self._loaded = True
        self.keep()

    def keep(self) -> None:
        """Make the folder again if somebody has deleted it, and what this process has announced in it: without the
        folder no process can be replaced, and what it counts for the first time has no place."""
        if self._folder is None:
            return
        self._folder.mkdir(mode=0o700, exist_ok=True)
        own, complete = self._folder / f"loaded_{os.getpid()}", self._folder / COMPLETE
        if self._loaded and not own.exists():
            own.write_text(_started(os.getpid()))
        if not complete.exists() and (self._complete or len(self.living()) >= self.count):
            complete.touch()

    def living(self) -> list[int]:
        """Process ids of loaded processes that are alive."""
        if self._folder is None:
            return []
        found = []
        for file in self._folder.glob("loaded_*"):
            pid = int(file.name.rpartition("_")[2])
            with suppress(FileNotFoundError):  # deleted meanwhile
                if is_alive(pid) and file.read_text() in ("", _started(pid)):  # "" before it is written, or no /proc
                    found.append(pid)
        return sorted(found)


def is_alive(pid: int) -> bool:
    """Whether a process with this id is alive, and of this user; a zombie is not."""
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    fields = _stat(pid)
    return not fields or fields[0] != "Z"


def _started(pid: int) -> str:
    """When a process started, in the system's ticks, which tells it from a later one with its id; "" without /proc."""
    fields = _stat(pid)
    return fields[19] if fields else ""


def _stat(pid: int) -> list[str]:
    """What /proc says of a process from its state on (proc(5), the fields from 3 on); nothing without /proc."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].decode().split()
    return []
