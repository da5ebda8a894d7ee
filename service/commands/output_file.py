"""The file that a command writes: looked at before the work, and named where the system refuses it after all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile

from ..errors import InputError

_DENIED = "no permission"
_CURE = "choose another folder, or ask who owns it for permission"


def check_output_file(path: Path) -> None:
    """Raises `InputError` where no file can be written at `path`: it is a folder, there is none for it, or it is not
    writable."""
    if path.is_dir():
        raise InputError(f"{path} is a folder, need a file", field="output", cure="name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder", field="output", cure="make it first")
    if path.exists() and not path.is_file():  # a pipe or device is written to where it is
        obstacle = None if os.access(path, os.W_OK) else _DENIED
    else:  # the file behind a link is replaced, in its own folder
        obstacle = _obstacle(path.resolve().parent)
    if obstacle:
        raise InputError(f"{path} cannot be written: {obstacle}", field="output", cure=_CURE)


def check_output_folder(path: Path) -> None:
    """Raises `InputError` where `path` is no folder and none can be made, or where it is not writable."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not there.is_dir():
        raise InputError(f"{there} is not a folder", field="output", cure="name a folder")
    if obstacle := _obstacle(there):
        raise InputError(f"{there} cannot be written into: {obstacle}", field="output", cure=_CURE)


def _obstacle(folder: Path) -> str | None:
    """Why no file can be made there, tried with one that has no name: of some file systems nothing else tells."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return _DENIED
    try:
        TemporaryFile(dir=folder).close()
    except OSError as error:
        return error.strerror or str(error)
    return None


@contextmanager
def named(path: Path) -> Iterator[None]:
    """What the system refuses within the block is said of `path`, and not of a file beside it or of none."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
