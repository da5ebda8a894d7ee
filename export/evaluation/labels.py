"""Names that tell paths apart: no longer than they need be, and as parts of file names."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path


def given_twice(paths: Sequence[Path]) -> Path | None:
    """The first path that leads where one before it does, or nothing."""
    seen: set[Path] = set()
    for path in paths:
        place = path.resolve()
        if place in seen:
            return path
        seen.add(place)
    return None


def shortest_names(paths: Sequence[Path]) -> list[str]:
    """The last parts of each path, as many of all as tell them apart: one where the names differ.

    Raises `ValueError` where two are the same path.
    """
    parts = [Path(os.path.abspath(path)).parts for path in paths]
    for count in range(1, max(map(len, parts), default=0) + 1):
        names = [str(Path(*own[-count:])) for own in parts]
        if len(set(names)) == len(names):
            return names
    if paths:
        raise ValueError(f"{', '.join(map(str, paths))}: the same path twice")
    return []


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Each name as the start of a file's: blanks and slashes become _, and what would be the same is numbered."""
    found: dict[str, str] = {}
    for name in names:
        plain = stem = re.sub(r"[\s/]", "_", name)
        number = 2
        while stem in found.values():
            stem, number = f"{plain}_{number}", number + 1
        found[name] = stem
    return found
