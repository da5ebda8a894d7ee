"""Who is alive, and how much each computes at a time: every process holds a lock on a file of its own, which its end
releases whatever that end is."""

from __future__ import annotations

import fcntl
import os
import uuid
from collections.abc import Iterable
from pathlib import Path


class Lease:
    """This process among those that share a store."""

    def __init__(self, folder: Path, slots: int = 1) -> None:
        """Take a name of one's own in `folder`, for `slots` jobs at a time, and remove those of the dead."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self.name = uuid.uuid4().hex
        unseen = folder / f".{self.name}"  # locked before anybody could take it for that of a dead process
        self._handle = os.open(unseen, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        fcntl.flock(self._handle, fcntl.LOCK_EX)
        os.write(self._handle, str(slots).encode())
        unseen.rename(folder / self.name)
        self.gone(path.name for path in folder.iterdir() if not path.name.startswith("."))

    def release(self) -> None:
        """Be gone for the others."""
        (self._folder / self.name).unlink(missing_ok=True)
        os.close(self._handle)

    def gone(self, names: Iterable[str]) -> set[str]:
        """Those of `names` that no living process has."""
        return {name for name in set(names) if name != self.name and not self._alive(name)}

    def slots(self) -> int:
        """Jobs that all living processes compute at a time, together."""
        names = {path.name for path in self._folder.iterdir() if not path.name.startswith(".")}
        return sum(self._slots(name) for name in names - self.gone(names))

    def _slots(self, name: str) -> int:
        try:
            told = (self._folder / name).read_text()
        except OSError:  # it went at this moment
            return 0
        return int(told) if told.isdecimal() else 1  # a full disk took it, or an earlier release tells nothing

    def _alive(self, name: str) -> bool:
        path = self._folder / name
        try:
            handle = os.open(path, os.O_RDWR)
        except FileNotFoundError:
            return False
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        else:
            path.unlink(missing_ok=True)
            return False
        finally:
            os.close(handle)
