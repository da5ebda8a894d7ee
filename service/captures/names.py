"""When two names mean the same photograph: case, slashes and composed letters aside, by how much of their paths."""

from __future__ import annotations

import posixpath
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

from .files import joined

MOST_PARTS = 4  # of a name, from its end, by which a photograph is looked for where the whole is not there


@lru_cache(maxsize=8192)
def key(name: str) -> str:
    """What two spellings of a path have in common: macOS stores letters decomposed, Windows writes backslashes."""
    return unicodedata.normalize("NFC", joined(name)).lower()


def same_file(posted: str, wanted: str | None) -> bool:
    """Whether the last parts of both paths agree but for case; a wanted name without a suffix matches any."""
    have, want = (posixpath.basename(key(name or "")) for name in (posted, wanted))
    return bool(want) and (have == want or ("." not in want.strip(".") and posixpath.splitext(have)[0] == want))


def same_path(typed: str, name: str | None) -> bool:
    """As `same_file`, and the folders agree as far up as both name them."""
    have, want = _folders(typed), _folders(name or "")
    shared = min(len(have), len(want))
    return same_file(typed, name) and have[len(have) - shared :] == want[len(want) - shared :]


def places_of(posted: str, names: Sequence[str | None]) -> list[int]:
    """Which of `names` mean the posted file: those whose last part is its own. Where it has folders, of these the very
    same, else those whose folders agree with its own as far up as both have some, else those with most of them."""
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
    """Where the photographs lie that are sorted by name."""
    return sorted(range(len(names)), key=lambda place: names[place])


class Endings:
    """The ends of the paths of a camera file: which of them stand for one name alone."""

    def __init__(self, names: Iterable[str | None]) -> None:
        self._counts = Counter(end for name in {key(name) for name in names if name} for end in _ends(name))

    def count(self, end: str) -> int:
        """How many different names end so."""
        return self._counts[key(end)]

    def of(self, name: str) -> list[str]:
        """Ends of `name` that no other name has, the longest first."""
        return [end for end in _ends(joined(name)) if self.count(end) == 1]


def _ends(name: str) -> Iterator[str]:
    """The last 4, 3, 2 and 1 parts of a path as paths, as far as it has so many."""
    parts = [part for part in name.rsplit("/", MOST_PARTS)[-MOST_PARTS:] if part]
    return ("/".join(parts[place:]) for place in range(len(parts)))
