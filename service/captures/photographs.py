"""Find the photographs of a capture by the names that its camera file has for them."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence

from ..errors import CaptureError, ImageError, ImageUnreadable
from ..image_files import MAX_PIXELS, image_size
from .files import Files, joined, read_bounded

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".PNG", ".JPG", ".JPEG", ".WEBP")
FOLDERS = ("images", "", "images_2", "images_4", "images_8", "input", "rgb")  # beside the cameras, in this order
MAX_PHOTOGRAPH_BYTES = 256 * 2**20
_HEADER = 2**18  # bytes that nearly always hold the size of a photograph


class Photographs:
    """The photographs below `base`, the folder of the capture, and below `beside`, that of its camera file."""

    def __init__(self, files: Files, base: str, beside: str, max_pixels: int = MAX_PIXELS) -> None:
        self._files = files
        self._max_pixels = max_pixels
        places = [joined(beside, "."), *(joined(base, folder) for folder in FOLDERS)]
        self._places = list(dict.fromkeys(places))
        self._listed: dict[str, dict[str, list[str]]] = {}

    def find(self, name: str | None, index: int) -> str:
        """Path of a photograph: at its name, else with a suffix that it lacks or in another case, else by the last part
        of it alone. Raises `ImageError`.
        """
        if name is None:
            message = "the camera file names no photograph for this view"
            raise ImageError(message, field="views.image", index=index, cure="name one for each view")
        found = self._at(name) or self._at(posixpath.basename(joined(name)))
        if found is None:
            looked = ", ".join(place or "." for place in self._places[:3])
            raise ImageError(
                f"{posixpath.join(self._files.label, name)} does not exist",
                field="views.image",
                index=index,
                cure=f"photographs are looked for in {looked} and the like, under the names that the cameras have",
            )
        return found

    def in_order(self, count: int) -> list[str]:
        """All photographs, sorted by name, of the first folder that has `count` of them. Raises `CaptureError`."""
        seen = {}
        for place in self._places:
            names = [name for name in self._files.files(place) if name.endswith(SUFFIXES)]
            if len(names) == count:
                return [joined(place, name) for name in names]
            if names:
                seen[place or "."] = len(names)
        have = ", ".join(f"{number} in {place}" for place, number in seen.items()) or "none"
        raise CaptureError(
            f"{count} cameras without names need {count} photographs in one folder, there are {have}",
            field="capture",
            cure="cameras belong to photographs in the order of their names: leave out none",
        )

    def read(self, path: str) -> bytes:
        """Raises `CaptureError` for a file that is too large or cannot be unpacked."""
        return read_bounded(self._files, path, MAX_PHOTOGRAPH_BYTES)

    def size_of(self, path: str, index: int) -> tuple[int, int]:
        """(width, height) in px, from the beginning of the file where that is enough. Raises `ImageError`."""
        with self._files.open(path) as stream:
            head = stream.read(_HEADER)
        try:
            return image_size(head, index=index, max_pixels=self._max_pixels)
        except ImageUnreadable:
            if len(head) < _HEADER:
                raise
        return image_size(self.read(path), index=index, max_pixels=self._max_pixels)

    def _at(self, name: str) -> str | None:
        suffixes = ("",) if name.endswith(SUFFIXES) else ("", *SUFFIXES)
        for place in self._places:
            path = joined(place, name)
            for suffix in suffixes:
                if self._files.has(path + suffix):
                    return path + suffix
        for place in self._places:
            folder, last = posixpath.split(joined(place, name))
            found = self._by_key(folder).get(last.lower(), [])
            if len(found) == 1:
                return joined(folder, found[0])
        return None

    def _by_key(self, folder: str) -> dict[str, list[str]]:
        """Photographs of a folder by their names in lower case, with and without suffix."""
        if folder not in self._listed:
            found: dict[str, list[str]] = {}
            for name in self._files.files(folder):
                if name.endswith(SUFFIXES):
                    for key in {name.lower(), posixpath.splitext(name)[0].lower()}:
                        found.setdefault(key, []).append(name)
            self._listed[folder] = found
        return self._listed[folder]


def same_file(posted: str, wanted: str | None) -> bool:
    """Whether the last parts of both paths agree but for case; a wanted name without a suffix matches any."""
    have, want = (posixpath.basename((name or "").replace("\\", "/").lower()) for name in (posted, wanted))
    return bool(want) and (have == want or ("." not in want.strip(".") and posixpath.splitext(have)[0] == want))


def sorted_places(names: Sequence[str]) -> list[int]:
    """Where the photographs lie that are sorted by name."""
    return sorted(range(len(names)), key=lambda place: names[place])
