"""A capture with several COLMAP models: where they are, how many images each has, and the notice that one is read."""

from __future__ import annotations

import re
import struct

from ..cameras.view_checks import Notice
from ..errors import CaptureError
from .colmap import has_colmap
from .files import Files, joined
from .table import MAX_LISTED

_PLACES = ("sparse", "colmap/sparse")  # whose folders the mapper fills: 0, 1, ...
_LISTED = 5  # models that the notice names
_HEAD = 4096  # bytes of images.txt in which its comments say how many images it has


def several_models(files: Files, base: str, chosen: str) -> tuple[Notice, ...]:
    """The notice `several_models` where the capture in `base` has other models than the chosen folder's; else none."""
    others = [folder for folder in models_below(files, base) if folder != chosen]
    if not others:
        return ()
    more = [f"{len(others) - _LISTED} more"] if len(others) > _LISTED else []
    passed_over = ", ".join([_described(files, folder) for folder in others[:_LISTED]] + more)
    other = joined(others[0], f"images.{has_colmap(files, others[0])}")
    message = (
        f"{len(others) + 1} COLMAP models are there: {_described(files, chosen)} is read, passed over are "
        f"{passed_over} (for another one name a file of it, such as {other}; in a zip keep its folder alone)"
    )
    return ({"code": "several_models", "field": "capture", "message": message},)


def models_below(files: Files, base: str) -> list[str]:
    """The folders that hold a model, numbered ones in the order of their numbers."""
    folders = [base]
    for place in (joined(base, name) for name in _PLACES):
        within = sorted(files.folders(place), key=lambda name: (len(name), name))
        folders += [place, *(joined(place, name) for name in within)]
    return [folder for folder in folders if has_colmap(files, folder) is not None]


def _described(files: Files, folder: str) -> str:
    """The folder, and how many images its model says that it has."""
    count = _images(files, folder)
    return (folder or "the capture's own folder") + ("" if count is None else f" ({count} images)")


def _images(files: Files, folder: str) -> int | None:
    """As the beginning of its list of images says; None where that says nothing that can be."""
    form = has_colmap(files, folder)
    try:
        with files.open(joined(folder, f"images.{form}")) as stream:
            head = stream.read(_HEAD if form == "txt" else 8)
    except CaptureError:  # it is not the model that is read
        return None
    if form == "txt":
        said = re.search(rb"Number of images: (\d{1,9})\b", head)
        return int(said[1]) if said else None
    count = struct.unpack("<Q", head)[0] if len(head) == 8 else MAX_LISTED + 1
    return count if count <= MAX_LISTED else None
