"""Strict query parameters: too many and repeated ones are refused by every route; by those that declare theirs as a
model unknown ones, numbers in other forms than the fields of a form have, and words for a flag but true and false."""

from __future__ import annotations

from collections import Counter
from typing import Any, get_args

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..errors import InputError

MOST = 64  # parameters of a request, several times those of any route: each is compared with all others, and answered


async def given_once(request: Request) -> None:
    """Raises `InputError` for more than `MOST` parameters, and `RequestValidationError` for those that are given more
    than once, of which one would win silently.

    A coroutine, since the framework would run a function on a worker thread."""
    values = request.query_params
    if (given := len(values.multi_items())) > MOST:
        cure = "send those that the route has: GET /openapi.json lists them"
        raise InputError(f"{given} parameters, need at most {MOST}", field="query", cure=cure)
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
    """A validator for single integer parameters: Python would accept +0 and 0_0 for 0."""
    if isinstance(value, str) and not (value.isascii() and value.isdigit()):
        raise PydanticCustomError("plain_number", "Input should be a whole number in decimal digits")
    return value


class Parameters(BaseModel):
    """Base of query models: unknown parameters, whole numbers that are not in decimal digits, other numbers with
    underscores, and other words than true and false are refused."""

    model_config = ConfigDict(extra="forbid")

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse what pydantic takes for a number or for true and the fields of a form do not, such as 1_0 and 10.0."""
        if not isinstance(value, str):
            return value
        kind = cls.model_fields[info.field_name or ""].annotation
        kinds = {kind, *get_args(kind)}
        if int in kinds:
            whole(value.removeprefix("-"))  # a range says more about a negative one
        elif float in kinds and "_" in value:
            raise PydanticCustomError("plain_number", "Input should be a number without _")
        if kind is bool and value.lower() not in ("true", "false"):
            raise PydanticCustomError("true_or_false", "Input should be true or false")
        return value
