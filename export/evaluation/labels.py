"""Names that tell paths apart: no longer than they need be, and as parts of file names."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

GENERATED_STEM = re.compile(r"generated_\d+")  # of the pictures of generated scenes, which other scenes keep clear of


def given_twice(paths: Sequence[Path]) -> Path | None:
    """The first path that leads where one before it does, or nothing."""
    seen: set[Path] = set()
    for path in paths:
        place = path.resolve()
        if place in seen:
            return path
        seen.add(place)
    return None


def shortest_names(paths: Sequence[Path], taken: Collection[str] = ()) -> list[str]:
    """The last parts of each path, as many of all as tell them apart, and from the names `taken`: one where the names
    differ.

    Raises `ValueError` where two are the same path.
    """
    parts = [Path(os.path.abspath(path)).parts for path in paths]
    for count in range(1, max(map(len, parts), default=0) + 1):
        names = [str(Path(*own[-count:])) for own in parts]
        if len(set(names)) == len(names) and not set(names) & set(taken):
            return names
    if paths:
        raise ValueError(f"{', '.join(map(str, paths))}: the same path twice")
    return []


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Each name as the start of a file's: blanks and slashes become _, and what would be the same, or a
    `GENERATED_STEM`, is numbered."""
    found: dict[str, str] = {}
    for name in names:
        plain = stem = re.sub(r"[\s/]", "_", name)
        number = 2
        while stem in found.values() or GENERATED_STEM.fullmatch(stem):
            stem, number = f"{plain}_{number}", number + 1
        found[name] = stem
    return found
