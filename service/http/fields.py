"""Text fields of a posted form as numbers and booleans; an empty field counts as missing."""

from __future__ import annotations

import math
from typing import TypeVar

from starlette.datastructures import FormData

from ..errors import InputError
from ..plain_number import plain_float
from .posted import text

_Otherwise = TypeVar("_Otherwise", int, None)


def number(form: FormData, name: str, refusal: type[InputError] = InputError) -> float | None:
    """A finite number; None if the field is missing. Raises `refusal`."""
    given = text(form, name)
    if not given:
        return None
    cure = "send a number such as 0.5, or leave it out"
    try:
        value = plain_float(given)
    except ValueError as error:
        raise refusal(f"{given[:100]!r} is not a number", field=name, cure=cure) from error
    if not math.isfinite(value):
        raise refusal(f"{value} is not finite", field=name, cure=cure)
    return value


def whole(form: FormData, name: str, otherwise: _Otherwise) -> int | _Otherwise:
    """An integer from 0 to 99,999,999; `otherwise` if the field is missing. Raises `InputError`."""
    given = text(form, name)
    if given and not (given.isascii() and given.isdigit() and len(given) < 9):
        cure = "send digits alone, such as 3, or leave it out"
        raise InputError(f"{given[:50]!r} is not a whole number", field=name, cure=cure)
    return int(given) if given else otherwise


def flag(form: FormData, name: str) -> bool:
    """`true` or `false` in any case; False if the field is missing. Raises `InputError`."""
    given = text(form, name).lower()
    if given not in ("", "false", "true"):
        cure = "send true, or leave it out for false"
        raise InputError(f"{given[:100]!r} is neither true nor false", field=name, cure=cure)
    return given == "true"
