"""Short distinct labels of paths, and file names made from them."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

GENERATED_STEM = re.compile(r"generated_\d+")  # reserved for pictures of generated scenes


def given_twice(paths: Sequence[Path]) -> Path | None:
    """The first path that resolves to the same file as an earlier one; None without duplicates."""
    seen: set[Path] = set()
    for path in paths:
        place = path.resolve()
        if place in seen:
            return path
        seen.add(place)
    return None


def shortest_names(paths: Sequence[Path], taken: Collection[str] = ()) -> list[str]:
    """The last n components of each path, with the smallest n for which all are distinct and none is in `taken`.

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
    """Name -> file stem: white space and slashes become _; duplicates and a `GENERATED_STEM` get a number appended."""
    found: dict[str, str] = {}
    for name in names:
        plain = stem = re.sub(r"[\s/]", "_", name)
        number = 2
        while stem in found.values() or GENERATED_STEM.fullmatch(stem):
            stem, number = f"{plain}_{number}", number + 1
        found[name] = stem
    return found
