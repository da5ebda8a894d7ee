"""Checks of what a Python program passes: numbers, also numpy's own, sequences, paths, and values of a given type."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable
from numbers import Integral, Real
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar

from .errors import InputError

T = TypeVar("T")


def whole_number(value: object) -> int | None:
    """The whole number that it is, of any type of them; None for anything else, also for 2.0, True and "2"."""
    value = _scalar(value)
    return operator.index(value) if isinstance(value, Integral) and not isinstance(value, bool) else None


def real_number(value: object) -> float | None:
    """The number that it is, infinite beyond float64; None for anything else, also for True, "2", 1j and arrays that
    have axes."""
    value = _scalar(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:  # whole numbers have no upper limit
        return math.inf


def shown(value: object) -> str:
    """For a message: a number as people write it, anything else as Python does, so that 2 and "2" are told apart."""
    try:
        return str(value) if isinstance(_scalar(value), Real) else f"{value!r:.50}"
    except ValueError:  # Python writes no whole number of so many digits
        return "a number of more digits than can be written"


def truth(value: object, field: str) -> bool:
    """True or False, also numpy's. Raises `InputError` for anything else: the text "no" would count as true."""
    found = _scalar(value)
    if not isinstance(found, bool):
        raise InputError(f"is {shown(value)}, need True or False", field=field)
    return found


def listed(values: Iterable[T], field: str) -> list[T]:
    """All of them, in order; those of an iterator as well. Raises `InputError` for what has no parts, and for text."""
    try:
        if isinstance(values, str | bytes):
            raise TypeError
        parts = iter(values)
    except TypeError:
        message = f"is a {type(values).__name__}, need several in a sequence"
        raise InputError(message, field=field, cure="give a list") from None
    return list(parts)


def of_type(value: object, kind: type[T], field: str, cure: str) -> T:
    """`value`, if it is a `kind`. Raises `InputError` for anything else."""
    if not isinstance(value, kind):
        raise InputError(f"is a {type(value).__name__}, need a {kind.__name__}", field=field, cure=cure)
    return value


def file_path(value: object, field: str, cure: str) -> Path:
    """The path that it is. Raises `InputError` for anything but text and paths."""
    path = fspath(value) if isinstance(value, PathLike) else value
    if not isinstance(path, str):  # paths of bytes are none of `pathlib`
        raise InputError(f"is a {type(value).__name__}, need a path", field=field, cure=cure)
    return Path(path)


def whole_numbers(values: Iterable[object], field: str) -> list[int]:
    """All of them as `int`. Raises `InputError` for what is not `listed` and, with its place, for what is none."""
    found = []
    for index, value in enumerate(listed(values, field)):
        number = whole_number(value)
        if number is None:
            raise InputError(f"is {shown(value)}, need a whole number", field=field, index=index)
        found.append(number)
    return found


def _scalar(value: Any) -> object:
    """A Python number in place of numpy's own or of an array without axes."""
    return value.item() if getattr(value, "shape", None) == () else value
