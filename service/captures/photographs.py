"""Finding the photographs of a capture by the names in its camera file."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from functools import cached_property

from ..errors import CaptureError, ImageError, ImageUnreadable
from ..photographs.image_files import MAX_PIXELS, image_size
from .elsewhere import Elsewhere
from .files import Files, joined, read_bounded
from .names import Endings, key

_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
_PROBED = (*_SUFFIXES, *(suffix.upper() for suffix in _SUFFIXES))  # behind a name that has none
FOLDERS = ("images", "", "images_2", "images_4", "images_8", "input", "rgb")  # that are searched, in this order
MAX_PHOTOGRAPH_BYTES = 256 * 2**20
_HEADER = 2**18  # bytes at the start that usually hold the size
_NUMBER = re.compile(r"(\d+)", re.ASCII)


def is_photograph(name: str) -> bool:
    """Whether a name has the suffix of a photograph, in whatever case."""
    return name.lower().endswith(_SUFFIXES)


def _with_numbers(name: str) -> list[tuple[int, str]]:
    """The key that sorts names by their numbers: its odd parts are the numbers, the even ones what stands between."""
    parts = _NUMBER.split(name)
    return [(int(part) if place % 2 else 0, part) for place, part in enumerate(parts)]


class Photographs:
    """The photographs below `base`, the folder of the capture, and `beside`, that of its camera file with these
    `names`."""

    def __init__(
        self, files: Files, base: str, beside: str, names: Sequence[str | None], max_pixels: int = MAX_PIXELS
    ) -> None:
        self._files = files
        self._names = names
        self._max_pixels = max_pixels
        places = [joined(beside, "."), *(joined(base, folder) for folder in FOLDERS)]
        self._places = list(dict.fromkeys(places))
        self._listed: dict[str, dict[str, list[str]]] = {}
        self._below: dict[str, dict[str, list[str]]] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        self._elsewhere = Elsewhere(files, base, self._folders_in, is_photograph)

    def find(self, name: str | None, index: int) -> str:
        """Path of a photograph: by its name, also with a missing suffix or in another case, else by a unique end of its
        name: `right/0.png` does not match a 0.png that may be `left/0.png`. Raises `ImageError`.
        """
        if name is None:
            message = "the camera file names no photograph for this view"
            raise ImageError(message, field="views.image", index=index, cure="name one for each view")
        found = self._at(name) or next(filter(None, map(self._at, self._endings.of(name))), None)
        if found is None:
            looked = ", ".join(place or "." for place in self._places[:3])
            cure = f"photographs are looked for in {looked} and the like, under the names that the cameras have"
            last = posixpath.basename(joined(name))
            if (count := self._endings.count(last)) > 1:
                cure += f"; {last} alone may be any of {count}: keep their folders" if self._at(last) else ""
            elif (hint := self._elsewhere.hint(name)) is not None:
                cure = f"{hint}; {cure}"
            message = f"{posixpath.join(self._files.label, name)} does not exist"
            raise ImageError(message, field="views.image", index=index, cure=cure)
        return found

    def in_order(self, count: int, *, by_number: bool = False) -> list[str]:
        """Sorted paths of the photographs in the first folder with `count` of them; `by_number` the numbers in their
        names are compared as such, so that 10.png follows 9.png. Raises `CaptureError`."""
        seen = {}
        for place in self._places:
            names = [name for name in self._files.files(place) if is_photograph(name)]
            if len(names) == count:
                return [joined(place, name) for name in (sorted(names, key=_with_numbers) if by_number else names)]
            if names:
                seen[place or "."] = len(names)
        have = ", ".join(f"{number} in {place}" for place, number in seen.items()) or "none"
        raise CaptureError(
            f"{count} cameras without names need {count} photographs in one folder, there are {have}",
            field="capture",
            cure="cameras belong to photographs in the order of their names: leave out none",
        )

    def read(self, path: str) -> bytes:
        """The content of a photograph. Raises `CaptureError` if it is too large or cannot be unpacked."""
        return read_bounded(self._files, path, MAX_PHOTOGRAPH_BYTES)

    def size_of(self, path: str, index: int) -> tuple[int, int]:
        """(width, height) in px, read once for each path. Raises `ImageError`."""
        if path not in self._sizes:
            self._sizes[path] = self._read_size(path, index)
        return self._sizes[path]

    def _read_size(self, path: str, index: int) -> tuple[int, int]:
        """From the start of the file if that suffices."""
        with self._files.open(path) as stream:
            head = stream.read(_HEADER)
        try:
            return image_size(head, index=index, max_pixels=self._max_pixels)
        except ImageUnreadable:
            if len(head) < _HEADER:
                raise
        return image_size(self.read(path), index=index, max_pixels=self._max_pixels)

    @cached_property
    def _endings(self) -> Endings:
        return Endings(self._names)

    def _at(self, name: str) -> str | None:
        suffixes = ("",) if is_photograph(name) else ("", *_PROBED)
        for place in self._places:
            path = joined(place, name)
            for suffix in suffixes:
                if self._files.has(path + suffix):
                    return path + suffix
        for place in self._places:
            folder, last = posixpath.split(joined(place, name))
            folder = self._folder(folder)
            found = self._by_key(folder).get(key(last), [])
            if len(found) == 1:
                return joined(folder, found[0])
        return None

    def _folder(self, path: str) -> str:
        """The folder at `path`, or the only one that differs in case."""
        found = ""
        for part in path.split("/") if path else ():
            same = self._named_like(found).get(key(part), [])
            if part not in same and len(same) != 1:
                return path
            found = joined(found, part if part in same else same[0])
        return found

    def _folders_in(self, folder: str) -> list[str]:
        return [name for same in self._named_like(folder).values() for name in same]

    def _named_like(self, folder: str) -> dict[str, list[str]]:
        """Names of the folders in `folder` by their `key`."""
        if folder not in self._below:
            self._below[folder] = {}
            for name in self._files.folders(folder):
                self._below[folder].setdefault(key(name), []).append(name)
        return self._below[folder]

    def _by_key(self, folder: str) -> dict[str, list[str]]:
        """Names of the photographs in a folder by their `key`, with and without suffix."""
        if folder not in self._listed:
            found: dict[str, list[str]] = {}
            for name in self._files.files(folder):
                if is_photograph(name):
                    for known in {key(name), posixpath.splitext(key(name))[0]}:
                        found.setdefault(known, []).append(name)
            self._listed[folder] = found
        return self._listed[folder]
