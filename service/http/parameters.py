"""Query parameters of a route as a model: one that is not among them is refused, and so is a number with a _ in it."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError


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
