"""Where the files of a capture are: a folder on disk here, a zip in `archive.py`, both read through `Files`."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

from ..errors import CaptureError

# Left beside photographs by file managers and archivers.
_CLUTTER = ("__macosx", "thumbs.db", "desktop.ini")


class Files(Protocol):
    """Read-only files under relative POSIX paths; the root is the empty path."""

    @property
    def label(self) -> str:
        """What to call it in a message."""

    def files(self, folder: str) -> Sequence[str]:
        """Names of the files directly in a folder, sorted; none where it is not there."""

    def folders(self, folder: str) -> Sequence[str]:
        """Names of the folders directly in a folder, sorted."""

    def has(self, path: str) -> bool:
        """Whether there is a file at the path."""

    def size(self, path: str) -> int:
        """Bytes of a file, as they are read."""

    def open(self, path: str) -> BinaryIO:
        """The file as a stream. Raises `CaptureError` where it cannot be read, then or while reading."""


class FolderFiles:
    """A folder on disk."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def label(self) -> str:
        return str(self.root)

    def files(self, folder: str) -> Sequence[str]:
        return self._entries(folder, folders=False)

    def folders(self, folder: str) -> Sequence[str]:
        return self._entries(folder, folders=True)

    def has(self, path: str) -> bool:
        try:
            return (self.root / path).is_file()
        except (OSError, ValueError):  # a name that no file can have
            return False

    def size(self, path: str) -> int:
        return (self.root / path).stat().st_size

    def open(self, path: str) -> BinaryIO:
        try:
            return (self.root / path).open("rb")
        except OSError as error:
            message = f"{self.root / path} cannot be read: {error.strerror}"
            raise CaptureError(message, field="capture", cure="ask who owns it for permission") from error

    def _entries(self, folder: str, *, folders: bool) -> Sequence[str]:
        try:
            entries = [path for path in (self.root / folder).iterdir() if path.is_dir() == folders]
        except OSError:
            return []
        return sorted(path.name for path in entries if not is_clutter(path.name))


def is_clutter(name: str) -> bool:
    """Whether a file or folder of this name was put there by a file manager."""
    return name.startswith(".") or name.lower() in _CLUTTER


def joined(*parts: str) -> str:
    """A relative POSIX path without `.`, `..` or empty parts where that can be; the root is the empty path."""
    path = posixpath.normpath(posixpath.join("", *(part.replace("\\", "/") for part in parts)))
    return "" if path == "." else path


def read_bounded(files: Files, path: str, most: int) -> bytes:
    """The whole file. Raises `CaptureError` where it has more than `most` bytes, before it is read where it says so."""
    size = files.size(path)
    if size <= most:
        with files.open(path) as stream:
            data = stream.read(size + 1)
        if len(data) <= size:
            return data
        cure = "is it being written? try again when it is whole"
        raise CaptureError(f"{path} has more bytes than the {size} that it is listed with", field="capture", cure=cure)
    cure = "is it the right file? send one that is smaller"
    raise CaptureError(f"{path} has {size} bytes or more, the limit is {most}", field="capture", cure=cure)
