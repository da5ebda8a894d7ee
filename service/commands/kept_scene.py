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
    """Where the block refuses to write `scene` to `output`, it is kept in a .ply beside that, unless there is one; the
    cure of the `FormatError` names it."""
    try:
        yield
    except FormatError as error:
        kept = output.with_name(f"{output.name}.ply")
        if not kept.exists():
            replace_file(kept, ply_bytes(scene.gaussians, positions=scene.positions))
            error.cure = f"{error.cure}; the scene is in {kept}" if error.cure else f"the scene is in {kept}"
        raise
