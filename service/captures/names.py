"""Matching names of photographs, ignoring case, slashes and Unicode composition, by the common end of their paths."""

from __future__ import annotations

import posixpath
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

from .files import joined

MOST_PARTS = 4  # of a path, from its end, by which a photograph is searched
LONGEST = 1024  # characters of a path; systems allow about 255 for each part of it


def key(name: str) -> str:
    """Normal form of a path: NFC, as macOS decomposes letters, slashes for the backslashes of Windows, lower case. One
    longer than LONGEST is not composed, which takes time with the square of its length, and not remembered."""
    return _known(name) if len(name) <= LONGEST else joined(name).lower()


@lru_cache(maxsize=8192)
def _known(name: str) -> str:
    return unicodedata.normalize("NFC", joined(name)).lower()


def same_file(posted: str, wanted: str | None) -> bool:
    """Whether the base names agree; a wanted name without a suffix matches any suffix."""
    have, want = (posixpath.basename(key(name or "")) for name in (posted, wanted))
    return bool(want) and (have == want or ("." not in want.strip(".") and posixpath.splitext(have)[0] == want))


def same_path(typed: str, name: str | None) -> bool:
    """As `same_file`, and the folders agree as far as both paths have them."""
    have, want = _folders(typed), _folders(name or "")
    shared = min(len(have), len(want))
    return same_file(typed, name) and have[len(have) - shared :] == want[len(want) - shared :]


def places_of(posted: str, names: Sequence[str | None]) -> list[int]:
    """Indices of the `names` that match a posted file: those with its base name. If it has folders, among these the
    equal paths, else those whose folders agree as far as both have them, else those that agree in most folders."""
    last = posixpath.basename(key(posted))
    near = [place for place, name in enumerate(names) if name and posixpath.basename(key(name)) == last]
    near = near or [place for place, name in enumerate(names) if same_file(posted, name)]
    if len(near) < 2 or not _folders(posted):
        return near
    exact = [place for place in near if key(names[place] or "") == key(posted)]
    agreeing = exact or [place for place in near if same_path(posted, names[place])]
    if agreeing:
        return agreeing
    have = _folders(posted)[::-1]
    shared = [len(posixpath.commonprefix([have, _folders(names[place] or "")[::-1]])) for place in near]
    most = max(shared)
    return [place for place, count in zip(near, shared, strict=True) if count == most]


def _folders(path: str) -> list[str]:
    return [part for part in key(path).split("/")[:-1] if part]


def sorted_places(names: Sequence[str]) -> list[int]:
    """Indices that sort the names."""
    return sorted(range(len(names)), key=lambda place: names[place])


class Endings:
    """Counts of the path ends of all names in a camera file, to tell which of them are unique."""

    def __init__(self, names: Iterable[str | None]) -> None:
        self._counts = Counter(end for name in {key(name) for name in names if name} for end in _ends(name))

    def count(self, end: str) -> int:
        """Number of different names with this end."""
        return self._counts[key(end)]

    def of(self, name: str) -> list[str]:
        """Ends of `name` that are unique, the longest first."""
        return [end for end in _ends(joined(name)) if self.count(end) == 1]


def _ends(name: str) -> Iterator[str]:
    """The last 4, 3, 2 and 1 parts of a path, as far as it has them."""
    parts = [part for part in name.rsplit("/", MOST_PARTS)[-MOST_PARTS:] if part]
    return ("/".join(parts[place:]) for place in range(len(parts)))
