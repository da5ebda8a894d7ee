"""Where two configurations or recipes differ, field by field, as the messages say it."""

from __future__ import annotations

from typing import Any

SHOWN = 8  # fields in a message
_NOTHING = object()


def differences(found: Any, asked: Any, *, other: str = "asked for") -> str:
    """`steps is 1, asked for 2; seed is 3, asked for 4`, or nothing for what is equal; `other` names the second.

    Both are of plain values, lists and objects; fields of fields are named as in `phases[0].share`, a plain value that
    is all there is has no name.
    """
    left, right = _fields(found), _fields(asked)
    said = []
    for name in [*left, *(name for name in right if name not in left)]:
        values = left.get(name, _NOTHING), right.get(name, _NOTHING)
        if values[0] != values[1]:
            first, second = (_shown(value) for value in values)
            said.append(f"{name} is {first}, {other} {second}" if name else f"{first}, {other} {second}")
    more = [f"{len(said) - SHOWN} more"] if len(said) > SHOWN else []
    return "; ".join(said[:SHOWN] + more)


def _fields(value: Any, name: str = "") -> dict[str, Any]:
    """Every plain value below, by its path; an empty list or object is one."""
    if isinstance(value, dict) and value:
        parts = [(f"{name}.{key}" if name else str(key), part) for key, part in value.items()]
    elif isinstance(value, (list, tuple)) and value:
        parts = [(f"{name}[{index}]", part) for index, part in enumerate(value)]
    else:
        return {name: value}
    return {path: plain for key, part in parts for path, plain in _fields(part, key).items()}


def _shown(value: Any) -> str:
    return "nothing" if value is _NOTHING else "none" if value is None else str(value)
