"""Captures with several COLMAP models: finding them, counting their images, choosing one, and a notice about it."""

from __future__ import annotations

import posixpath
import re
import struct
from collections.abc import Sequence

from ..cameras.view_checks import Notice
from ..errors import CameraError, CaptureError
from .colmap import FORMS, WHOLE, has_colmap
from .colmap_text import read_images
from .files import Files, joined
from .table import MAX_LISTED

_PLACES = ("sparse", "colmap/sparse")  # the mapper writes models into their folders 0, 1, ...
_LISTED = 5  # models that the notice names
_HEAD = 4096  # bytes of images.txt that hold its comments with the number of images


def several_models(files: Files, models: Sequence[str], chosen: str) -> tuple[Notice, ...]:
    """The notice `several_models` if there are models beside the chosen one; else empty."""
    others = [folder for folder in models if folder != chosen]
    if not others:
        return ()
    more = [f"{len(others) - _LISTED} more"] if len(others) > _LISTED else []
    passed_over = ", ".join([_described(files, folder) for folder in others[:_LISTED]] + more)
    other = joined(others[0], f"images.{has_colmap(files, others[0])}")
    message = (
        f"{len(others) + 1} COLMAP models are there: {_described(files, chosen)} is read; ignored: "
        f"{passed_over} (for another one name a file of it, such as {other}; in a zip keep its folder alone)"
    )
    return ({"code": "several_models", "field": "capture", "message": message},)


def largest_model(files: Files, models: Sequence[str], first: str) -> str:
    """The one with the most images of `models` among the numbered siblings of `first`, which is one of them: COLMAP's
    mapper may leave two images in model 0 and all others in 1. `first` itself where it has no number, or its images
    cannot be counted."""
    if not posixpath.basename(first).isdecimal() or _images(files, first) is None:
        return first
    beside = [folder for folder in models if posixpath.dirname(folder) == posixpath.dirname(first)]
    numbered = [folder for folder in beside if posixpath.basename(folder).isdecimal()]
    return max(numbered, key=lambda folder: _images(files, folder) or 0)


def numbered_alone(files: Files, folders: Sequence[str]) -> list[str]:
    """`folders` of the root in numerical order if each is a numbered model, as the mapper writes them; else empty."""
    if not all(folder.isdecimal() and has_colmap(files, folder) for folder in folders):
        return []
    return sorted(folders, key=lambda name: (len(name), name))


def parts_of_models(files: Files, folders: Sequence[str]) -> str:
    """A sentence about the first of `folders` that holds cameras of COLMAP without images, or images without cameras;
    empty if none does."""
    for folder in folders:
        for form in FORMS:
            there = [name for name in WHOLE if files.has(joined(folder, f"{name}.{form}"))]
            if len(there) == 1:
                (missing,) = set(WHOLE) - set(there)
                return f"{joined(folder, f'{there[0]}.{form}')} is there without {missing}.{form} beside it"
    return ""


def models_below(files: Files, base: str) -> list[str]:
    """Folders with a model, numbered ones in numerical order."""
    return [folder for folder in places_of_models(files, base) if has_colmap(files, folder) is not None]


def places_of_models(files: Files, base: str) -> list[str]:
    """Folders that may have a model, numbered ones in numerical order."""
    folders = [base]
    for place in (joined(base, name) for name in _PLACES):
        within = sorted(files.folders(place), key=lambda name: (len(name), name))
        folders += [place, *(joined(place, name) for name in within)]
    return folders


def _described(files: Files, folder: str) -> str:
    """The folder, with the number of images of its model."""
    count = _images(files, folder)
    return (folder or "the capture's own folder") + ("" if count is None else f" ({count} images)")


def _images(files: Files, folder: str) -> int | None:
    """Number of images by the start of the file of images, of a text without it by its lines; None if it cannot be read
    or is implausible."""
    form = has_colmap(files, folder)
    path = joined(folder, f"images.{form}")
    try:
        with files.open(path) as stream:
            head = stream.read(_HEAD if form == "txt" else 8)
        if form == "txt":
            said = re.search(rb"Number of images: (\d{1,9})\b", head)
            if said:
                return int(said[1])
            with files.open(path) as stream:
                return len(read_images(stream, path))
    except (CaptureError, CameraError):  # this model is not needed
        return None
    count = struct.unpack("<Q", head)[0] if len(head) == 8 else MAX_LISTED + 1
    return count if count <= MAX_LISTED else None
