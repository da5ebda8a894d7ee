"""What the commands share: the lists of views that are given on the command line."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import ViewError


def view_indices(text: str, count: int) -> list[int]:
    """Indices such as `4,8`. Raises `ViewError` for anything else, for a missing one and for a repeated one."""
    indices = []
    for part in text.split(","):
        part = part.strip()
        if not part.isascii() or not part.isdigit():
            raise ViewError(f"{part!r} is not a view index", field="views", cure="give indices such as 0,2")
        if int(part) >= count:
            raise ViewError(
                f"view {part} does not exist, the file has {count} views", field="views", cure=f"0 to {count - 1}"
            )
        if int(part) in indices:
            raise ViewError(f"view {part} is given twice", field="views")
        indices.append(int(part))
    return indices


def view_specs(text: str) -> Sequence[str]:
    """Views to render, such as `5,6.5`: without repetition, in the order given."""
    specs = list(dict.fromkeys(part.strip() for part in text.split(",")))
    if not all(specs):
        raise ViewError(f"{text!r} has an empty entry", field="views", cure="give views such as 5,6.5")
    return specs
