"""Which processes are alive, and how many jobs each runs at once: every process holds a lock on a file of its own, and
the system releases it however the process ends."""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
import uuid
from collections.abc import Iterable
from pathlib import Path

from ..process.disk import made_again, private_folder


class Lease:
    """The lock file of this process, in a folder that all processes of a store share."""

    def __init__(self, folder: Path, slots: int = 1) -> None:
        """Create and lock a file in `folder` that announces `slots`, and delete files of processes that have ended."""
        self._folder, self._own = folder, str(slots)
        self.name = uuid.uuid4().hex
        self._keeping, self._released = threading.Lock(), False
        self._handle = self._announced()
        self.gone(path.name for path in folder.iterdir() if not path.name.startswith("."))

    def _announced(self) -> int:
        private_folder(self._folder.parent)  # the store
        private_folder(self._folder)
        unseen = self._folder / f".{self.name}"  # renamed once it is locked, so that no other process deletes it
        handle = os.open(unseen, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        fcntl.flock(handle, fcntl.LOCK_EX)
        with contextlib.suppress(OSError):  # a full disk, see `_slots`
            os.write(handle, self._own.encode())
        unseen.rename(self._folder / self.name)
        return handle

    def keep(self) -> bool:
        """Make the file again if somebody has deleted it, since to others this process has ended then; returns whether
        it was there. Raises `ServiceBusy` if that fails."""
        with self._keeping:
            if self._released or (self._folder / self.name).exists():
                return True
            with made_again(self._folder):
                deleted, self._handle = self._handle, self._announced()
            os.close(deleted)
            return False

    def release(self) -> None:
        """Delete the file: other processes see this one as ended."""
        with self._keeping:
            self._released = True
            (self._folder / self.name).unlink(missing_ok=True)
            os.close(self._handle)

    def gone(self, names: Iterable[str]) -> set[str]:
        """Those of the lease `names` that no living process holds; their files are deleted. None where the file of this
        process was deleted: those of others were, too, and they have to make theirs again."""
        if not self.keep():
            return set()
        return {name for name in set(names) if name != self.name and not self._alive(name)}

    def slots(self) -> int:
        """Sum of the slots of all living processes."""
        self.keep()
        names = {path.name for path in self._folder.iterdir() if not path.name.startswith(".")}
        return sum(self._slots(name) for name in names - self.gone(names))

    def _slots(self, name: str) -> int:
        try:
            told = (self._folder / name).read_text()
        except OSError:  # deleted meanwhile
            return 0
        return int(told) if told.isdecimal() else 1  # empty: a full disk, or an earlier release that wrote nothing

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
