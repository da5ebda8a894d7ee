"""What the reader of a format gives: the views that are listed, and their cameras once they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..cameras.camera_fields import CameraFile, SizeOf
from ..cameras.view_checks import Notice
from ..errors import CameraError

MAX_LISTED = 20_000  # views of one file; a count above it is a damaged or hostile file


@dataclass(frozen=True)
class CameraTable:
    """The views of a camera file in the order that indices count."""

    kind: str  # of the file: cameras.json, transforms.json, colmap, llff, realestate10k
    source: str  # the file's path in its capture
    names: tuple[str | None, ...]  # of the photographs, as the file has them
    parse: Callable[[Sequence[int], SizeOf | None], CameraFile]  # the cameras of these views, in this order
    by_sorted_name: bool = False  # view i belongs to photograph i of all that there are, sorted by name
    warnings: tuple[Notice, ...] = ()  # what was passed over for this file


def check_listed(count: int, source: str) -> None:
    """Raises `CameraError` for no view at all, or more than any capture has."""
    if not 1 <= count <= MAX_LISTED:
        message = f"{source} lists {count} views, need 1 to {MAX_LISTED}"
        raise CameraError(message, field="cameras", cure="is it the right file, and complete?")
