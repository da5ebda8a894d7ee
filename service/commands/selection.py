"""What the commands share: the lists of views that are given on the command line."""

from __future__ import annotations

from collections.abc import Sequence

from ..captures.select import named_views
from ..errors import ViewError


def view_indices(text: str, count: int) -> list[int]:
    """Indices such as `4,8`. Raises `ViewError` for anything else, for a missing one and for a repeated one."""
    return named_views(text, (None,) * count, field="views")


def view_specs(text: str) -> Sequence[str]:
    """Views to render, such as `5,6.5`: without repetition, in the order given."""
    specs = list(dict.fromkeys(part.strip() for part in text.split(",")))
    if not all(specs):
        raise ViewError(f"{text!r} has an empty entry", field="views", cure="give views such as 5,6.5")
    return specs
