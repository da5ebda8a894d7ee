"""Writing files durably, replacing files atomically, and `StorageFull` for a full disk."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from ..errors import ServiceBusy, StorageFull
from .ending import unfinished
from .places import open_taking, resolved, takes_bytes

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
NO_FILE = (errno.EMFILE, errno.ENFILE)


def write_file(path: Path, data: bytes) -> None:
    """Write a file and sync it to disk."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def private_folder(path: Path) -> None:
    """Make a folder of the store where it is missing, for this user alone: it is to hold photographs. One that exists
    keeps its mode."""
    path.mkdir(mode=0o700, parents=True, exist_ok=True)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` for the block to write. At its end that file replaces `path`; if the block fails,
    it is deleted.

    Owner and mode of an existing `path` are kept. Of a symbolic link the target is replaced. A pipe, a device and an
    open stream are not replaced: the complete file is written to them.
    """
    if takes_bytes(path):
        with TemporaryDirectory(prefix="gapmes-") as folder, unfinished(Path(folder)):
            yield Path(folder) / "part"
            with (Path(folder) / "part").open("rb") as made, open_taking(path) as taken:
                shutil.copyfileobj(made, taken)
        return
    path = resolved(path)
    if not path.parent.is_dir():
        number = errno.ENOTDIR if path.parent.exists() else errno.ENOENT
        raise OSError(number, os.strerror(number), str(path))  # Python makes it the subclass for its errno
    part = path.with_name(f".gapmes-{secrets.token_hex(8)}")
    with unfinished(part):
        try:
            before = path.stat() if path.exists() else None
            if before is not None:
                part.touch(0o600, exist_ok=False)  # readable by nobody else until it has the mode of `path`
            yield part
            if before is not None:
                with suppress(PermissionError):  # only root may change owners
                    os.chown(part, before.st_uid, before.st_gid)
                with suppress(PermissionError):  # a file system without modes
                    part.chmod(stat.S_IMODE(before.st_mode) & 0o777)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def replace_file(path: Path, data: bytes) -> None:
    """Write a file, replacing an existing one atomically; a path that `takes_bytes` is written to instead."""
    if takes_bytes(path):
        with open_taking(path) as taken:
            taken.write(data)
        return
    with replacing(path) as part:
        write_file(part, data)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """An `OSError` of the block is raised with `path` as its file name, whatever file it was about."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def sync(path: Path) -> None:
    """Sync a file, or the entries of a folder, to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


IN_STORE = ("store", "delete scenes, or give it more room")
IN_TEMPORARY = ("TMPDIR", "make room in the folder for temporary files, or set TMPDIR to a folder that has some")


@contextmanager
def full_is_refused(what: str, place: tuple[str, str] = IN_STORE) -> Iterator[None]:
    """Raises `StorageFull` if the block fails on a full disk, a quota, or the process's limit on file sizes; `place` is
    the error's field and cure."""
    field, cure = place
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise StorageFull(f"no space for {what}: {error.strerror}", field=field, cure=cure) from error
        raise


def no_further_file() -> ServiceBusy:
    """The error for a process, or a system, that has as many open files as it may have."""
    return ServiceBusy("the service may open no further file now", cure="retry later")


@contextmanager
def made_again(folder: Path, field: str = "store") -> Iterator[None]:
    """Raises `ServiceBusy` if the block, which makes a folder again that somebody has deleted, fails."""
    try:
        yield
    except OSError as error:
        raise ServiceBusy(
            f"the folder {folder.name} was deleted and cannot be made again: {error.strerror}",
            field=field,
            cure="retry later: whoever runs the service has to put it back, where it can be written",
        ) from error
