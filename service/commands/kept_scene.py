"""A scene that took minutes to make and does not fit into the format that was asked for: it is kept as a .ply."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import FormatError
from ..formats.ply import ply_bytes
from ..process.disk import replace_file

if TYPE_CHECKING:
    from ..reconstruct import Scene


@contextmanager
def kept_if_refused(output: Path, scene: Scene) -> Iterator[None]:
    """Where the block refuses to write `scene` to `output`, it is kept in a .ply beside that, unless there is a file of
    that name or none can be written; the cure of the `FormatError` says which."""
    try:
        yield
    except FormatError as error:
        said = _kept(output.with_name(f"{output.name}.ply"), scene)
        error.cure = f"{error.cure}; {said}" if error.cure else said
        raise


def _kept(path: Path, scene: Scene) -> str:
    if path.exists():
        return f"the scene is not kept, since there is a {path} already"
    try:
        replace_file(path, ply_bytes(scene.gaussians, positions=scene.positions))
    except OSError as error:
        return f"the scene is not kept, since {path} cannot be written: {error.strerror}"
    return f"the scene is in {path}"
