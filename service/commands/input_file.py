"""Early check of the file of Gaussians that a command reads."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError


def check_input_file(path: Path, field: str) -> None:
    """Raises `InputError` unless the path is a file or a pipe."""
    if not (path.is_file() or path.is_fifo()):
        raise InputError(f"{path} is not a file", field=field, cure="give a .ply, .compressed.ply, .splat or .spz")
