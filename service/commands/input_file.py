"""The file of Gaussians that a command reads, looked at before the work."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError


def check_input_file(path: Path, field: str) -> None:
    """Raises `InputError` where it is a folder or a device, or there is nothing; a pipe is a file."""
    if not (path.is_file() or path.is_fifo()):
        raise InputError(f"{path} is not a file", field=field, cure="give a .ply, .compressed.ply, .splat or .spz")
