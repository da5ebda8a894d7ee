"""Early checks of the file or folder that a command writes to."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryFile

from ..errors import InputError
from .places import is_mounted, is_stdout, open_file, resolved, takes_bytes

_OUTPUT = "output"  # what most commands call it
_DENIED = "no permission"
_CURE = "choose another folder, or ask who owns it for permission"


def check_output_file(path: Path, *, as_json: bool = False, field: str = _OUTPUT) -> None:
    """Raises `InputError` if no file can be written at `path`: it is a folder, its folder is missing or not writable,
    or with `as_json` it is stdout, which the result is written to. `field` is what the command calls it."""
    if path.is_dir():
        raise InputError(f"{path} is a folder, need a file", field=field, cure="name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent} is not a folder", field=field, cure="make it first")
    if as_json and is_stdout(path):
        raise InputError(f"{path} is where --json writes to", field=field, cure="leave --json out, or name a file")
    if open_file(path) is not None:  # an open stream is written to as it is
        return
    if takes_bytes(path):
        obstacle = None if os.access(path, os.W_OK) else _DENIED
    else:  # the target of a link is replaced, in its own folder
        obstacle = _obstacle(_replaced(path, field).parent)
    if obstacle:
        raise InputError(f"{path} cannot be written: {obstacle}", field=field, cure=_CURE)


def _replaced(path: Path, field: str) -> Path:
    """The file to be replaced, with links resolved. Raises `InputError` for a broken link or a mount point."""
    try:
        file = resolved(path)
    except OSError as error:
        raise InputError(f"{path} is a link that leads to itself", field=field, cure="remove it") from error
    if not file.parent.is_dir():
        raise InputError(
            f"{path} is a link to {file}, whose folder does not exist",
            field=field,
            cure="make it, or remove the link",
        )
    if is_mounted(file):
        raise InputError(
            f"{path} is a mount of its own, and no new file can take its place", field=field, cure="mount its folder"
        )
    return file


def check_output_folder(path: Path, *, field: str = _OUTPUT) -> None:
    """Raises `InputError` if `path` is not a writable folder and cannot be created as one; `field` is what the command
    calls it."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.exists() or folder.is_symlink())
    if not there.exists():
        raise InputError(
            f"{there} is a link to {there.readlink()}, which is no folder",
            field=field,
            cure="make it, or remove the link",
        )
    if not there.is_dir():
        raise InputError(f"{there} is not a folder", field=field, cure="name a folder")
    if obstacle := _obstacle(there):
        raise InputError(f"{there} cannot be written into: {obstacle}", field=field, cure=_CURE)


def _obstacle(folder: Path) -> str | None:
    """Why no file can be created in a folder, None if one can: tried, as permissions do not always tell."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return _DENIED
    try:
        TemporaryFile(dir=folder).close()
    except OSError as error:
        return error.strerror or str(error)
    return None
