"""The files of a store beside its scenes that the service must be able to write, whoever has made them."""

from __future__ import annotations

import errno
import os
from pathlib import Path

OWN = (
    ".lock",
    ".writing",
    ".jobs",
    ".processes",
    "index.sqlite.lock",
    *(f"index.sqlite{end}" for end in ("", "-wal", "-shm")),
)


def check_own_files(root: Path) -> None:
    """Raises `PermissionError` for the first that is there and that this user may not write: root may have made it."""
    for path in (root / name for name in OWN):
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
