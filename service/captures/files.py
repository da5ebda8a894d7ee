"""Access to the files of a capture: the interface `Files`, and folders on disk; zips are in `archive.py`."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

from ..errors import CaptureError

# Files that file managers and archivers create.
_CLUTTER = ("__macosx", "thumbs.db", "desktop.ini")


class Files(Protocol):
    """Read-only files under relative POSIX paths; the root is the empty path."""

    @property
    def label(self) -> str:
        """Its name for messages."""

    def files(self, folder: str) -> Sequence[str]:
        """Sorted names of the files in a folder; empty if it does not exist."""

    def folders(self, folder: str) -> Sequence[str]:
        """Sorted names of the folders in a folder; empty if it does not exist."""

    def has(self, path: str) -> bool:
        """Whether a file exists at the path."""

    def size(self, path: str) -> int:
        """Size of a file in bytes, unpacked. Raises `CaptureError` if it cannot be read."""

    def open(self, path: str) -> BinaryIO:
        """Open a file for reading. Raises `CaptureError` if it cannot be read, also while reading."""


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
        except (OSError, ValueError):  # an invalid name
            return False

    def size(self, path: str) -> int:
        with self._readable(path):
            return (self.root / path).stat().st_size

    def open(self, path: str) -> BinaryIO:
        with self._readable(path):
            return (self.root / path).open("rb")

    @contextmanager
    def _readable(self, path: str) -> Iterator[None]:
        """Raises `CaptureError` where the block cannot read the file."""
        try:
            yield
        except OSError as error:
            gone = isinstance(error, FileNotFoundError)
            raise CaptureError(
                f"{self.root / path} cannot be read: {error.strerror}",
                field="capture",
                cure="was it moved or deleted?" if gone else "ask who owns it for permission",
            ) from error

    def _entries(self, folder: str, *, folders: bool) -> Sequence[str]:
        try:
            names = os.listdir(self.root / folder)
        except (OSError, ValueError):  # missing, or an invalid name
            return []
        kind = os.path.isdir if folders else os.path.isfile  # False, too, for a link that cannot be followed
        return sorted(name for name in names if not is_clutter(name) and kind(self.root / folder / name))


def is_clutter(name: str) -> bool:
    """Whether a name is hidden, or one that file managers create."""
    return name.startswith(".") or name.lower() in _CLUTTER


def joined(*parts: str) -> str:
    """Join and normalise a relative POSIX path; the root is the empty path, and leading `..` remain."""
    path = posixpath.normpath(posixpath.join("", *(part.replace("\\", "/") for part in parts)))
    return "" if path == "." else path


def read_bounded(files: Files, path: str, most: int) -> bytes:
    """The content of a file. Raises `CaptureError` if it has more than `most` bytes, by its size before it is read."""
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
