"""JSON of users, in which no object may have the same member twice: one of the two would be left out silently."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any


class RepeatedMember(ValueError):
    """An object has a member twice; the message names it."""


CURE = "keep the one that is meant"


def parsed(text: str | bytes, parse_int: Callable[[str], float] = int) -> Any:
    """As `json.loads`. Raises `RepeatedMember` for an object with a member that is repeated."""
    return json.loads(text, parse_int=parse_int, object_pairs_hook=_object)


def _object(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        name, count = Counter(name for name, _ in pairs).most_common(1)[0]
        raise RepeatedMember(f"has {name[:50]!r} {count} times in one object, need it once")
    return found
