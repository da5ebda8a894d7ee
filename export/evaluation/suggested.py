"""The views that a scene folder suggests as inputs and as held-out targets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gapmes.service.captures.capture import Capture
from gapmes.service.captures.files import Files, FolderFiles, read_bounded
from gapmes.service.captures.recognise import MAX_CAMERA_BYTES
from gapmes.service.errors import InputError
from gapmes.service.plain_number import counted

Views = dict[str, list[int]]  # context2, target2, context3 and so on -> view indices


class NoSuchViews(InputError):
    """A scene has no inputs of this number, or no targets for them."""


def suggestions(path: Path) -> Views | None:
    """What the `cameras.json` of a folder suggests, or this file itself; None where there is none or it says nothing.
    Raises `InputError` for what is no JSON, and for lists of anything but whole numbers."""
    file = path if path.name == "cameras.json" else path / "cameras.json"
    return _suggested(FolderFiles(file.parent), file.name, file) if file.is_file() else None


def suggested_by(capture: Capture, path: Path) -> Views | None:
    """The same of an open capture at `path`, such as a zip, whose cameras come from a file of this kind."""
    if capture.table.kind != "cameras.json":
        return None
    return _suggested(capture.files, capture.table.source, path / capture.table.source)


def _suggested(files: Files, name: str, file: Path) -> Views | None:
    try:
        document = json.loads(read_bounded(files, name, MAX_CAMERA_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is no JSON: {error}", field="SCENE_DIR") from error
    if not isinstance(document, dict) or "suggested" not in document:
        return None
    suggested: Any = document["suggested"]
    lists = suggested.values() if isinstance(suggested, dict) else [None]
    if not all(isinstance(views, list) and all(type(view) is int for view in views) for views in lists):
        raise InputError(
            f"{file}: need lists of view indices in an object, got {str(suggested)[:80]}",
            field="suggested",
            cure='for example {"context2": [1, 5], "target2": [2, 3, 4]}',
        )
    return suggested


def suggested_views(path: Path, suggested: Views, inputs: int) -> tuple[list[int], list[int]]:
    """Inputs and targets for a number of inputs of the scene at `path`.

    Raises `NoSuchViews` where nothing is suggested, and `InputError` for another number of inputs and for a target that
    is an input.
    """
    names = _names(inputs)
    context, targets = (suggested.get(name) for name in names)
    if not context or not targets:
        raise NoSuchViews(
            f"{path} suggests no {names[0]} with {names[1]}",
            field="suggested",
            cure=f'add "suggested": {{"{names[0]}": [...], "{names[1]}": [...]}} with view indices',
        )
    if len(context) != inputs:
        raise InputError(
            f"{path}: {names[0]} = {context} names {counted(len(context), 'view')}, need {inputs}",
            field=f"suggested.{names[0]}",
        )
    if shared := sorted(set(context) & set(targets)):
        raise InputError(
            f"{path}: {', '.join(map(str, shared))} both in {names[0]} = {context} and {names[1]} = {targets}",
            field="suggested",
            cure="a target is held out: name views that are no inputs",
        )
    return context, targets


def check_indices(path: Path, inputs: int, views: tuple[Sequence[int], Sequence[int]], count: int) -> None:
    """Raises `InputError` for an input or target outside of the scene's `count` views, or named twice."""
    for name, indices in zip(_names(inputs), views, strict=True):
        for place, view in enumerate(indices):
            if not 0 <= view < count:
                raise InputError(
                    f"{path}: is {view}, the scene has {counted(count, 'view')}: need 0 to {count - 1}",
                    field=f"suggested.{name}[{place}]",
                    index=view,
                    cure="views are counted from 0, in the order of the file",
                )
            if (first := indices.index(view)) < place:
                raise InputError(
                    f"{path}: is {view}, as {name}[{first}] is",
                    field=f"suggested.{name}[{place}]",
                    index=view,
                    cure="name each view once",
                )


def _names(inputs: int) -> tuple[str, str]:
    return f"context{inputs}", f"target{inputs}"
