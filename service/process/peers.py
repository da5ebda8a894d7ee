"""The processes that share a port tell one another that they are loaded, by files in the folder of their numbers."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

FOLDER = "PROMETHEUS_MULTIPROC_DIR"  # names it, read by the library of the numbers when it is imported
OURS = "gapmes-metrics-"  # how the name of one begins that `gapmes serve` makes, and may remove
COMPLETE = "complete"


class Peers:
    """`count` processes with one folder; a process without one is alone.

    The port is theirs together: the system hands a connection to any of them that listens. So that a client which was
    told that the service is ready finds nobody who is not, the service is ready when all are, the first time; who comes
    after that, in place of one that died, listens only when it is loaded, or when nobody else is.
    """

    def __init__(self, count: int, folder: Path | None) -> None:
        self.count = count
        self._folder = folder if count > 1 else None
        self._complete = self._folder is None

    @property
    def complete(self) -> bool:
        """Whether all were loaded at one time; once known it stays so, whoever tidies the folder."""
        if self._folder is not None and not self._complete:
            self._complete = (self._folder / COMPLETE).exists()
        return self._complete

    @property
    def wanted(self) -> bool:
        """Whether one that is not loaded should answer, too: not all were loaded yet, or none is now."""
        return not self.complete or not self.living()

    def loaded(self) -> None:
        """This process is."""
        if self._folder is not None:
            (self._folder / f"loaded_{os.getpid()}").touch()
            if len(self.living()) >= self.count:
                (self._folder / COMPLETE).touch()

    def living(self) -> list[int]:
        """Which processes are loaded and alive."""
        if self._folder is None:
            return []
        told = (int(file.name.rpartition("_")[2]) for file in self._folder.glob("loaded_*"))
        return sorted(pid for pid in told if is_alive(pid))


def is_alive(pid: int) -> bool:
    """Whether a process of ours has this number, and has not ended: one that ended has it until its parent looks."""
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    with suppress(OSError):  # not every system has such a file
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] != b"Z"
    return True
