"""The file that a command writes: looked at before the work, and named where the system refuses it after all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError

_CURE = "choose another folder, or ask who owns it for permission"


def check_output_file(path: Path) -> None:
    """Raises `InputError` where no file can be written at `path`: it is a folder, there is none for it, or it is not
    writable."""
    if path.is_dir():
        raise InputError(f"{path} is a folder, need a file", field="output", cure="name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder", field="output", cure="make it first")
    if path.exists() and not path.is_file():  # a pipe or device is written to where it is
        writable = os.access(path, os.W_OK)
    else:  # the file behind a link is replaced, in its own folder
        writable = os.access(path.resolve().parent, os.W_OK | os.X_OK)
    if not writable:
        raise InputError(f"{path} cannot be written: no permission", field="output", cure=_CURE)


def check_output_folder(path: Path) -> None:
    """Raises `InputError` where `path` is no folder and none can be made, or where it is not writable."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not there.is_dir():
        raise InputError(f"{there} is not a folder", field="output", cure="name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{there} cannot be written into: no permission", field="output", cure=_CURE)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """What the system refuses within the block is said of `path`, and not of a file beside it or of none."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
