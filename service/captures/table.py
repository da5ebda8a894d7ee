"""The result of camera file readers: a list of views, whose cameras are parsed on demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..cameras.camera_fields import CameraFile, SizeOf
from ..cameras.view_checks import Notice
from ..errors import CameraError

MAX_LISTED = 20_000  # views of one file; more are taken for a damaged or hostile file


@dataclass(frozen=True)
class CameraTable:
    """The views of a camera file, in the order of their indices."""

    kind: str  # of the file: cameras.json, transforms.json, colmap, llff, realestate10k
    source: str  # the file's path in its capture
    names: tuple[str | None, ...]  # of the photographs, as the file has them
    parse: Callable[[Sequence[int], SizeOf | None], CameraFile]  # cameras of the views at these indices
    by_sorted_name: bool = False  # view i belongs to photograph i in order of names
    warnings: tuple[Notice, ...] = ()  # about files that were ignored


def check_listed(count: int, source: str) -> None:
    """Raises `CameraError` unless there are 1 to `MAX_LISTED` views."""
    if not 1 <= count <= MAX_LISTED:
        message = f"{source} lists {count} views, need 1 to {MAX_LISTED}"
        raise CameraError(message, field="cameras", cure="is it the right file, and complete?")
