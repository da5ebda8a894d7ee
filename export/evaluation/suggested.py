"""The views that a scene folder suggests as inputs and as held-out targets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapmes.service.captures.capture import SceneFolder, load_scene_folder
from gapmes.service.captures.files import FolderFiles, read_bounded
from gapmes.service.captures.recognise import MAX_CAMERA_BYTES
from gapmes.service.errors import InputError
from gapmes.service.plain_number import counted


class NoSuchViews(InputError):
    """A scene folder suggests no inputs of this number, or no targets for them."""


@dataclass(frozen=True)
class SuggestedViews:
    """A scene folder with the indices of its inputs and targets, valid and distinct."""

    scene: SceneFolder
    inputs: tuple[int, ...]
    targets: tuple[int, ...]


def suggested_views(folder: Path, inputs: int) -> SuggestedViews:
    """The views that `cameras.json` suggests for a number of inputs.

    Raises `NoSuchViews` where it suggests none, and `InputError` for a folder that is no scene, another number of
    inputs, a view that is missing or named twice, and a target that is an input.
    """
    path = folder / "cameras.json"
    if not path.is_file():
        raise InputError(f"{path} is not a file", field="SCENE_DIR", cure="name a folder with images/ and cameras.json")
    suggested = _suggested(path)
    names = f"context{inputs}", f"target{inputs}"
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
    scene = load_scene_folder(folder)
    for name, views in zip(names, (context, targets), strict=True):
        _check_indices(path, name, views, len(scene.file.views))
    if shared := sorted(set(context) & set(targets)):
        raise InputError(
            f"{path}: {', '.join(map(str, shared))} both in {names[0]} = {context} and {names[1]} = {targets}",
            field="suggested",
            cure="a target is held out: name views that are no inputs",
        )
    return SuggestedViews(scene, tuple(context), tuple(targets))


def _check_indices(path: Path, name: str, views: Sequence[int], count: int) -> None:
    """Raises `InputError` for a view outside of the scene's `count`, or named twice."""
    for place, view in enumerate(views):
        if not 0 <= view < count:
            raise InputError(
                f"{path}: is {view}, the scene has {counted(count, 'view')}: need 0 to {count - 1}",
                field=f"suggested.{name}[{place}]",
                index=view,
                cure="views are counted from 0, in the order of the file",
            )
        if (first := views.index(view)) < place:
            raise InputError(
                f"{path}: is {view}, as {name}[{first}] is",
                field=f"suggested.{name}[{place}]",
                index=view,
                cure="name each view once",
            )


def _suggested(path: Path) -> dict[str, list[int]]:
    try:
        document = json.loads(read_bounded(FolderFiles(path.parent), path.name, MAX_CAMERA_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON: {error}", field="SCENE_DIR") from error
    suggested: Any = document.get("suggested", {}) if isinstance(document, dict) else None
    lists = suggested.values() if isinstance(suggested, dict) else [None]
    if not all(isinstance(views, list) and all(type(view) is int for view in views) for views in lists):
        raise InputError(
            f"{path}: need lists of view indices in an object, got {str(suggested)[:80]}",
            field="suggested",
            cure='for example {"context2": [1, 5], "target2": [2, 3, 4]}',
        )
    return suggested
