"""Folders for a while, which nobody mistakes for one that a kill has left, and which go when the next one is made."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .file_lock import exclusive_if_free, shared

_LOCK = ".lock"
YOUNG_S = 60.0  # so long a folder may be there before it is locked


@contextmanager
def own_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """A new one whose name begins with `prefix`, among temporary files or in `parent`, which goes with the block; those
    that begin so and that no living process holds go first."""
    parent = parent or Path(tempfile.gettempdir())
    for left in parent.glob(f"{prefix}*"):
        _drop_if_left(left)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=parent) as name, in_use(Path(name)):
        yield Path(name)


@contextmanager
def in_use(folder: Path) -> Iterator[None]:
    """During the block the folder is in use, whoever has made it."""
    with shared(folder / _LOCK):
        yield


def _drop_if_left(folder: Path) -> None:
    try:
        if time.time() - folder.stat().st_mtime > YOUNG_S:
            with exclusive_if_free(folder / _LOCK) as free:
                if free:
                    shutil.rmtree(folder, ignore_errors=True)
    except OSError:  # it goes at this moment, or is another user's
        return
