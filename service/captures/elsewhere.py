"""Photographs of a capture that lie where none are looked for, for the errors about those that are missing."""

from __future__ import annotations

import posixpath
from collections import deque
from collections.abc import Callable, Sequence

from .files import Files, joined
from .names import key

MOST_FOLDERS = 16  # that are looked into; captures have some ten, zips may have thousands
MOST_NAMES = 20_000  # of photographs that are remembered
NO_PHOTOGRAPHS = ("mask", "depth", "normal", "semantic")  # in names of folders: their pictures have photographs' names


class Elsewhere:
    """The photographs in the folders below `base`, the outer ones first, listed when the first one is missing.
    `folders` lists those in a folder, and `is_photograph` tells of a file's name."""

    def __init__(
        self, files: Files, base: str, folders: Callable[[str], Sequence[str]], is_photograph: Callable[[str], bool]
    ) -> None:
        self._files = files
        self._base = base
        self._folders = folders
        self._is_photograph = is_photograph
        self._found: dict[str, str] | None = None  # last part of the path, with and without suffix -> path

    def hint(self, name: str) -> str | None:
        """Where the photograph may be that a camera file calls `name`; None where nothing has that name."""
        last = posixpath.basename(key(name))
        found = self._listed()
        if path := found.get(last):
            return f"{path} has this name: if it is this photograph, put it where photographs are looked for"
        if path := found.get(posixpath.splitext(last)[0]):
            return f"{path} has another suffix: if it is this photograph, give it the one that its camera names"
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
        waiting, looked = deque([self._base]), 0
        while waiting and looked < MOST_FOLDERS and len(found) < MOST_NAMES:
            folder, looked = waiting.popleft(), looked + 1
            found += [joined(folder, name) for name in self._files.files(folder) if self._is_photograph(name)]
            for name in self._folders(folder):
                if not any(word in name.lower() for word in NO_PHOTOGRAPHS):
                    waiting.append(joined(folder, name))
        return found[:MOST_NAMES]
