"""Photographs of a capture that lie where none are looked for, for the errors about those that are missing."""

from __future__ import annotations

import posixpath
from collections import deque
from collections.abc import Callable, Sequence

from .files import Files, joined
from .names import key

MOST_FOLDERS = 16  # that are looked into; captures have some ten, zips may have thousands
MOST_NAMES = 20_000  # of photographs that are remembered


class Elsewhere:
    """The photographs in the folders of a capture, the outer ones first, listed when the first one is missing.
    `folders` lists those in a folder."""

    def __init__(self, files: Files, folders: Callable[[str], Sequence[str]], suffixes: tuple[str, ...]) -> None:
        self._files = files
        self._folders = folders
        self._suffixes = suffixes
        self._found: dict[str, str] | None = None  # last part of the path, with and without suffix -> path

    def hint(self, name: str) -> str | None:
        """How the photograph that a camera file calls `name` could be found; None where nothing has that name."""
        last = posixpath.basename(key(name))
        found = self._listed()
        if path := found.get(last):
            folder = posixpath.dirname(path)
            moved = f"rename the folder {folder} to images" if folder else "put it into a folder images"
            return f"{path} has this name: {moved}, or write that path into the camera file"
        if path := found.get(posixpath.splitext(last)[0]):
            return f"{path} has another suffix: if it is this photograph, write its name into the camera file"
        return None

    def _listed(self) -> dict[str, str]:
        if self._found is None:
            self._found = {}
            for path in self._paths():
                last = posixpath.basename(key(path))
                for known in (last, posixpath.splitext(last)[0]):
                    self._found.setdefault(known, path)
        return self._found

    def _paths(self) -> list[str]:
        found: list[str] = []
        waiting, looked = deque([""]), 0
        while waiting and looked < MOST_FOLDERS and len(found) < MOST_NAMES:
            folder, looked = waiting.popleft(), looked + 1
            found += [joined(folder, name) for name in self._files.files(folder) if name.endswith(self._suffixes)]
            waiting += [joined(folder, name) for name in self._folders(folder)]
        return found[:MOST_NAMES]
