"""Captures in, scenes out: the chosen views of a folder, a zip or a camera file with its photographs, reconstructed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from .arguments import file_path, listed, of_type
from .cameras.depth_range import checked_depth
from .cameras.view_checks import MAX_VIEWS, MIN_VIEWS
from .captures.capture import ChosenViews, open_capture
from .captures.select import ViewSelection, checked_selection
from .errors import ViewCountError, ViewError
from .options import Options, checked_options
from .photographs.image_files import image_size
from .photographs.images import EncodedPhoto
from .progress import Listener, Stages, silent
from .reconstruct import Reconstructor, Scene


def reconstruct_capture(
    path: str | Path,
    *,
    views: str | Iterable[int | str] | None = None,
    context: int | None = None,
    near: float | None = None,
    far: float | None = None,
    reconstructor: Reconstructor | None = None,
    listener: Listener = silent,
    **options: Any,
) -> Scene:
    """Reconstruct a `Scene` from a capture of any format that `gapmes reconstruct` takes, COLMAP's for example.

    `path`: a folder, a zip, or a camera file with its photographs beside it.
    `views`: names or indices of the views to use, in a list or separated by commas; `context`: how many to choose
    instead, 2 to 6. Without either all views of up to six are used, else the best three.
    `near`, `far`: z-depths in the cameras' units, in place of the capture's own or the estimate.
    `reconstructor`: one that is loaded already, or None for `Reconstructor()`.
    `options`: as for its `reconstruct`, but for `numbers`, which are the capture's.

    The scene's document has `selection`, which views these are and why, and the warnings about the capture too. Errors
    and warnings count views as the capture does. Raises `InputError` and `ModelError`.
    """
    place = file_path(path, "path", "give a folder, a .zip or a camera file")
    for name in options:
        if name not in Options._fields:
            raise TypeError(f"reconstruct_capture() got an unexpected keyword argument {name!r}")
    made = checked_options(**options)._asdict()
    if reconstructor is not None:
        of_type(reconstructor, Reconstructor, "reconstructor", "give a Reconstructor, or leave it out")
    wanted = checked_selection(ViewSelection(_selection(views), context, field="views"))
    near, far = (end if end is None else checked_depth(end, name) for name, end in (("near", near), ("far", far)))
    found = open_capture(place).choose(wanted, near, far)
    near, far = found.checked_depths(near, far)
    return reconstruct_chosen(reconstructor or Reconstructor(), found, near=near, far=far, listener=listener, **made)


def _selection(views: str | Iterable[int | str] | None) -> str | None:
    """As a text. Raises `ViewCountError` for an empty list, and `ViewError` for a name that a text cannot hold."""
    if views is None or isinstance(views, str):
        return views
    parts = [str(view) for view in listed(views, "views")]
    if not parts:
        raise ViewCountError(
            f"0 views, need {MIN_VIEWS} to {MAX_VIEWS}", field="views", cure="leave it out for a choice"
        )
    for place, part in enumerate(parts):
        if "," in part:
            raise ViewError(f"{part[:100]!r} has a comma", field="views", index=place, cure="give the view's index")
    return ",".join(parts)


def reconstruct_chosen(
    reconstructor: Reconstructor,
    found: ChosenViews,
    *,
    near: float | None,
    far: float | None,
    listener: Listener = silent,
    **options: Any,
) -> Scene:
    """As `reconstruct_capture`, of views that are chosen already, with near and far as `found.checked_depths` has them.
    `listener` hears the stage read images, too."""
    stages = Stages(listener)
    with stages.stage("read images", len(found.indices)) as step:
        photos = []
        for place, (index, view) in enumerate(zip(found.indices, found.file.views, strict=True)):
            data = found.read(place)
            image_size(data, index=index)  # checked here, so that the error has the index in the file
            photos.append(EncodedPhoto(data, lens=view.lens))
            step(len(photos))
    scene = reconstructor.reconstruct(
        photos, found.file.cameras, near=near, far=far, numbers=found.indices, listener=listener, **options
    )
    warnings = [*found.warnings, *scene.document["warnings"]]
    return replace(scene, document={"selection": found.selection, **scene.document, "warnings": warnings})
