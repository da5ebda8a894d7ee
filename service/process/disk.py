"""Files that survive a power cut, or take the place of others when they are whole; a full disk refused by name."""

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

from ..errors import StorageFull
from .ending import unfinished
from .places import open_taking, resolved, takes_bytes

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_file(path: Path, data: bytes) -> None:
    """Write a file through to the disk."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside `path` for the block to write: what is there takes the place of `path`, or goes if the block fails.

    Who may read and write `path` may do so after it. Of a link it is the file behind it that is replaced. A pipe, a
    device and a stream that is open stay what they are: once the file is whole they are written to.
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
        raise OSError(number, os.strerror(number), str(path))  # which becomes the class of its number
    part = path.with_name(f".gapmes-{secrets.token_hex(8)}")
    with unfinished(part):
        try:
            before = path.stat() if path.exists() else None
            if before is not None:
                part.touch(0o600, exist_ok=False)  # while it is written, nobody reads what others may not read
            yield part
            if before is not None:
                with suppress(PermissionError):  # only root gives files away
                    os.chown(part, before.st_uid, before.st_gid)
                with suppress(PermissionError):  # of a file system that has no modes
                    part.chmod(stat.S_IMODE(before.st_mode) & 0o777)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def replace_file(path: Path, data: bytes) -> None:
    """Write a file, new or in the place of another, which stays whole until then; what `takes_bytes` is written to."""
    if takes_bytes(path):
        with open_taking(path) as taken:
            taken.write(data)
        return
    with replacing(path) as part:
        write_file(part, data)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """What the system refuses within the block is said of `path`, and not of a file beside it or of none."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def sync(path: Path) -> None:
    """Make a file, or what was renamed into a folder, survive a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def full_is_refused(what: str) -> Iterator[None]:
    """Raises `StorageFull` where the block fails because the disk, a quota or a limit of the process is full."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise StorageFull(
                f"no space for {what}: {error.strerror}", field="store", cure="delete scenes, or give it more room"
            ) from error
        raise
