"""Captures with several COLMAP models: finding them, counting their images, choosing one, and a notice about it."""

from __future__ import annotations

import posixpath
import re
import struct
from collections.abc import Mapping, Sequence

from ..cameras.view_checks import Notice
from ..errors import CameraError, CaptureError
from .colmap import FORMS, WHOLE, has_colmap
from .colmap_text import read_images
from .files import Files, joined
from .table import MAX_LISTED

_PLACES = ("sparse", "colmap/sparse")  # the mapper writes models into their folders 0, 1, ...
_LISTED = 5  # models that the notice names
_HEAD = 4096  # bytes of images.txt that hold its comments with the number of images
MAX_COUNTED = 16  # models whose lines are counted, which takes up to 0.3 s each; a mapper's texts say their number
Counts = Mapping[str, int | None]  # of images, by the folder of the model; None where it is not known


def image_counts(files: Files, models: Sequence[str], first: str) -> Counts:
    """The number of images of each of `models` by the start of its file; of texts that do not say it, among the
    numbered siblings of `first`, by their lines, each read once, at most MAX_COUNTED of them."""
    counts = {folder: _announced(files, folder) for folder in models}
    numbered = _numbered_beside(models, first)
    silent = [folder for folder in numbered if counts[folder] is None and has_colmap(files, folder) == "txt"]
    for folder in silent[:MAX_COUNTED] if len(numbered) > 1 else ():
        counts[folder] = _counted(files, folder)
    return counts


def several_models(files: Files, counts: Counts, chosen: str) -> tuple[Notice, ...]:
    """The notice `several_models` if there are models beside the chosen one; else empty."""
    models = list(counts)
    others = [folder for folder in models if folder != chosen]
    if not others:
        return ()
    more = [f"{len(others) - _LISTED} more"] if len(others) > _LISTED else []
    passed_over = ", ".join([_described(counts, folder) for folder in others[:_LISTED]] + more)
    other = joined(others[0], f"images.{has_colmap(files, others[0])}")
    message = (
        f"{len(others) + 1} COLMAP models are there: {_described(counts, chosen)} is read; ignored: "
        f"{passed_over} (for another one name a file of it, such as {other}; in a zip keep its folder alone)"
    )
    return ({"code": "several_models", "field": "capture", "message": message},)


def largest_model(counts: Counts, first: str) -> str:
    """The one with the most images among the numbered siblings of `first`, which is one of them: COLMAP's
    mapper may leave two images in model 0 and all others in 1. `first` itself where it has no number, or its images
    cannot be counted."""
    numbered = _numbered_beside(list(counts), first)
    if not numbered or counts[first] is None:
        return first
    return max(numbered, key=lambda folder: counts[folder] or 0)


def _numbered_beside(models: Sequence[str], first: str) -> list[str]:
    """The numbered models in the folder of `first`, itself among them; none where it has no number."""
    if not posixpath.basename(first).isdecimal():
        return []
    beside = [folder for folder in models if posixpath.dirname(folder) == posixpath.dirname(first)]
    return [folder for folder in beside if posixpath.basename(folder).isdecimal()]


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


def _described(counts: Counts, folder: str) -> str:
    """The folder, with the number of images of its model."""
    count = counts[folder]
    return (folder or "the capture's own folder") + ("" if count is None else f" ({count} images)")


def _announced(files: Files, folder: str) -> int | None:
    """Number of images by the start of the file of images; None if it is missing or implausible."""
    form = has_colmap(files, folder)
    try:
        with files.open(joined(folder, f"images.{form}")) as stream:
            head = stream.read(_HEAD if form == "txt" else 8)
    except CaptureError:  # this model is not needed
        return None
    if form == "txt":
        said = re.search(rb"Number of images: (\d{1,9})\b", head)
        return int(said[1]) if said else None
    count = struct.unpack("<Q", head)[0] if len(head) == 8 else MAX_LISTED + 1
    return count if count <= MAX_LISTED else None


def _counted(files: Files, folder: str) -> int | None:
    """Number of images in a text; None where it is damaged."""
    path = joined(folder, "images.txt")
    try:
        with files.open(path) as stream:
            return len(read_images(stream, path))
    except CameraError:  # this model is not needed
        return None
