"""Temporary folders with a lock: one that a killed process has left is deleted when the next one is created."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .file_lock import exclusive_if_free, shared

_LOCK = ".lock"
YOUNG_S = 60.0  # a folder may exist for so long before it is locked


@contextmanager
def own_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """A new folder with this prefix, in `parent` or the system's folder for temporary files, deleted after the block.
    Those of this user with this prefix that no living process uses are deleted before."""
    parent = parent or Path(tempfile.gettempdir())
    for left in parent.glob(f"{prefix}*"):
        _drop_if_left(left)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=parent) as name, in_use(Path(name)):
        yield Path(name)


@contextmanager
def in_use(folder: Path) -> Iterator[None]:
    """Lock a folder as used during the block, whoever has created it."""
    with shared(folder / _LOCK):
        yield


def drop_unused(folder: Path) -> None:
    """Delete a folder unless it is in use or missing."""
    with suppress(OSError), exclusive_if_free(folder / _LOCK) as free:  # deleted meanwhile, or another user's
        if free:
            shutil.rmtree(folder, ignore_errors=True)


def _drop_if_left(folder: Path) -> None:
    with suppress(OSError):  # deleted meanwhile
        status = folder.lstat()
        own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid()  # in another's, .lock may lead anywhere
        if own and time.time() - status.st_mtime > YOUNG_S:
            drop_unused(folder)
