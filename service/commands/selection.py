"""Parsing of lists of views on the command line."""

from __future__ import annotations

from collections.abc import Sequence

from ..captures.select import named_views
from ..errors import ViewError


def view_indices(text: str, count: int) -> list[int]:
    """Indices such as `4,8`. Raises `ViewError` for anything else, for a missing one and for a repeated one."""
    return named_views(text, (None,) * count, field="views")


def view_specs(text: str, *, repeated: bool = False) -> Sequence[str]:
    """Views to render, such as `5,6.5`, in the order given: each once, or as often as it is named where `repeated`."""
    specs = [part.strip() for part in text.split(",")]
    if not all(specs):
        raise ViewError(f"{text!r} has an empty entry", field="views", cure="give views such as 5,6.5")
    return specs if repeated else list(dict.fromkeys(specs))
