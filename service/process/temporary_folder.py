"""The folder for temporary files of the service: TMPDIR, and no other, where it is set."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError
from .disk import IN_TEMPORARY, full_is_refused, made_again


def use_temporary_folder() -> None:
    """Make the folder TMPDIR, which may not exist yet on a new volume, and keep to it: Python would take another one,
    perhaps in memory, while it is full. Raises `OSError` if it cannot be made or written, and `InputError` if TMPDIR is
    not set and no usual folder can be written."""
    given = os.environ.get("TMPDIR")
    if given:
        Path(given).mkdir(parents=True, exist_ok=True)
        if not os.access(given, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), given)
        tempfile.tempdir = os.path.abspath(given)
        return
    try:
        tempfile.gettempdir()
    except FileNotFoundError as error:
        raise InputError(
            f"is not set, and there is {str(error.strerror)[:1].lower()}{str(error.strerror)[1:]}",
            field="TMPDIR",
            cure=f"let it name a folder that this user (uid {os.getuid()}) may write",
        ) from error


@contextmanager
def temporary_files(what: str) -> Iterator[None]:
    """Around a block that writes temporary files; their folder is made again where somebody has deleted it. Raises
    `ServiceBusy` if that fails, and `StorageFull` where there is no space for `what`."""
    folder = Path(tempfile.gettempdir())
    with full_is_refused(what, IN_TEMPORARY):
        with made_again(folder, "TMPDIR"):
            folder.mkdir(parents=True, exist_ok=True)
        yield
