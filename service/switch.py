"""On or off in a variable of the environment: one set of words for all switches."""

from __future__ import annotations

import os

from .errors import InputError

_WORDS = dict.fromkeys(("1", "true", "yes", "on"), True) | dict.fromkeys(("0", "false", "no", "off"), False)
NEED = "1, true, yes or on, or 0, false, no or off"


def switch(text: str) -> bool | None:
    """Whether the word, in any case, means on; None for one that means neither."""
    return _WORDS.get(text.lower())


def switched_on(name: str) -> bool:
    """Whether the variable is set and means on; an empty one counts as not set. Raises `InputError`."""
    text = os.environ.get(name) or "0"
    found = switch(text)
    if found is None:
        raise InputError(f"is {text[:50]!r}, need {NEED}", field=name)
    return found
