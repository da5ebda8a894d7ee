"""The result of camera file readers: a list of views, whose cameras are parsed on demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..cameras.camera_fields import CameraFile, SizeOf
from ..cameras.view_checks import Notice
from ..errors import CameraError
from .names import LONGEST

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

    def __post_init__(self) -> None:
        """Raises `CameraError` for a name that no file can have: all names are compared with each other."""
        for index, name in enumerate(self.names):
            if name is not None and len(name) > LONGEST:
                message = (
                    f"{self.source} has a name of {len(name)} characters, {name[:50]!r}..., need at most {LONGEST}"
                )
                cure = "is it a camera file, and complete? name the photograph by its path"
                raise CameraError(message, field="cameras", index=index, cure=cure)


def check_listed(count: int, source: str) -> None:
    """Raises `CameraError` unless there are 1 to `MAX_LISTED` views."""
    if not 1 <= count <= MAX_LISTED:
        message = f"{source} lists {count} views, need 1 to {MAX_LISTED}"
        raise CameraError(message, field="cameras", cure="is it the right file, and complete?")
