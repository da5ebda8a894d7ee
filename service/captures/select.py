"""Requests for views of a capture: by name, by index, or by their number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..arguments import shown, whole_number
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from ..errors import InputError, ViewCountError, ViewError
from ..plain_number import counted
from .names import same_file, same_path

DEFAULT_CONTEXT = 3  # views of a capture that has more than six; a third costs 0.6 of the time of the first two


@dataclass(frozen=True)
class ViewSelection:
    """The user's selection. By default all views of up to six, else three that are chosen automatically."""

    select: str | None = None  # names or indices, separated by commas
    context: int | None = None  # number of views to choose
    field: str = "select"  # name of the user's field or option for `select`


def checked_selection(wanted: ViewSelection) -> ViewSelection:
    """Returns `wanted`. Raises `ViewCountError` for a number outside 2..6, `InputError` for what is no whole number and
    for both kinds of selection."""
    if wanted.context is not None and whole_number(wanted.context) is None:
        raise InputError(f"is {shown(wanted.context)}, need a whole number", field="context")
    if wanted.context is not None and not MIN_VIEWS <= wanted.context <= MAX_VIEWS:
        cure = f"leave it out for {DEFAULT_CONTEXT} of a large capture"
        raise ViewCountError(
            f"{counted(wanted.context, 'view')}, need {MIN_VIEWS} to {MAX_VIEWS}", field="context", cure=cure
        )
    if wanted.select is not None and wanted.select.count(",") >= MAX_VIEWS:
        count = wanted.select.count(",") + 1
        cure = "name those that overlap most, or say how many to choose"
        raise ViewCountError(f"{count} views, need {MIN_VIEWS} to {MAX_VIEWS}", field=wanted.field, cure=cure)
    if wanted.context is not None and wanted.select is not None:
        raise InputError(f"is given beside {wanted.field}", field="context", cure="name the views, or say how many")
    return wanted


def named_views(
    text: str, names: Sequence[str | None], *, field: str, path_of: Callable[[int], str | None] = lambda _: None
) -> list[int]:
    """Indices of the views in `text`, such as `4,8` or `a.jpg,b.jpg`; a name wins over the same text as an index.

    A name is that in the camera file, a unique end of it, or the path of the photograph by `path_of`. Raises
    `ViewError` for anything else, for a view that does not exist and for one that is given twice.
    """
    indices: list[int] = []
    for part in text.split(","):
        index = _index_of(part.strip(), names, field, path_of)
        if index in indices:
            raise ViewError(f"view {part.strip()} is given twice", field=field, cure="name each view once")
        indices.append(index)
    return indices


def several_named_views(
    text: str, names: Sequence[str | None], *, field: str, path_of: Callable[[int], str | None] = lambda _: None
) -> list[int]:
    """As `named_views`, for a reconstruction. Raises `ViewCountError` for a single view, too."""
    indices = named_views(text, names, field=field, path_of=path_of)
    if len(indices) < MIN_VIEWS:
        cure = "name more of them, separated by commas: one view has no parallax"
        raise ViewCountError(
            f"{counted(len(indices), 'view')}, need {MIN_VIEWS} to {MAX_VIEWS}", field=field, cure=cure
        )
    return indices


def _index_of(part: str, names: Sequence[str | None], field: str, path_of: Callable[[int], str | None]) -> int:
    shown = part[:100]
    found = [index for index, name in enumerate(names) if part and name == part]
    found = found or [index for index, name in enumerate(names) if part and same_path(part, name)]
    found = found or [index for index, name in enumerate(names) if same_file(part, name) and path_of(index) == part]
    if len(found) == 1:
        return found[0]
    if found:
        raise ViewError(f"{len(found)} views are named {shown!r}", field=field, cure="give their indices")
    count = len(names)
    if part.isascii() and part.isdigit():
        if len(part) < 10 and int(part) < count:
            return int(part)
        raise ViewError(
            f"view {shown} does not exist, the file has {counted(count, 'view')}", field=field, cure=f"0 to {count - 1}"
        )
    known = ", ".join(name for name in names[:5] if name)
    raise ViewError(
        f"{shown!r} is not a view index" + (", nor the name of a view" if known else ""),
        field=field,
        cure="give indices such as 0,2" + (f", or names such as {known}" if known else ""),
    )
