"""Query parameters: one that is given twice is refused by every route, and by those that have theirs as a model one
that is not among them, and a number with a _ in it."""

from __future__ import annotations

from collections import Counter
from typing import Any, get_args

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError


async def given_once(request: Request) -> None:
    """Raises `RequestValidationError` for parameters that are given more than once: one would win without a word.

    A coroutine, since the framework gives functions a thread, for which every request would wait."""
    values = request.query_params
    counts = Counter(name for name, _ in values.multi_items())
    told = "{} times, need it once"
    errors = [
        {"type": "repeated", "loc": ("query", name), "msg": told.format(count), "input": values.getlist(name)}
        for name, count in counts.items()
        if count > 1
    ]
    if errors:
        raise RequestValidationError(errors)


def whole(value: Any) -> Any:
    """Before a whole number that stands by itself is read: Python reads +0 and 0_0 as 0, too."""
    if isinstance(value, str) and not (value.isascii() and value.isdigit()):
        raise PydanticCustomError("plain_number", "Input should be a whole number in decimal digits")
    return value


class Parameters(BaseModel):
    """What a slip of the pen would change without a word is noticed."""

    model_config = ConfigDict(extra="forbid")

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any, info: ValidationInfo) -> Any:
        """Python reads 1_0 as 10; nobody else does."""
        kind = cls.model_fields[info.field_name or ""].annotation
        if isinstance(value, str) and "_" in value and {int, float} & {kind, *get_args(kind)}:
            raise PydanticCustomError("plain_number", "Input should be a number without _")
        return value
