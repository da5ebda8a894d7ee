"""Inputs of a command: an early check of the file of Gaussians and of its format, and the capture of an option."""

from __future__ import annotations

from pathlib import Path

from ..captures.capture import Capture, open_capture
from ..errors import CameraError, CaptureError, InputError
from ..formats.registry import format_named


def check_input_file(path: Path, field: str, format: str | None) -> None:
    """Raises `InputError` unless the path is a file or a pipe and `format`, that of --from, one of Gaussians."""
    if format is not None:
        format_named(format, field="from")
    if str(path) == "-" and not path.exists():
        cure = "name /dev/stdin, with --from for a .splat"
        raise InputError("- does not stand for stdin", field=field, cure=cure)
    if not (path.is_file() or path.is_fifo()):
        raise InputError(f"{path} is not a file", field=field, cure="give a .ply, .compressed.ply, .splat or .spz")


def capture_of_option(path: Path, field: str) -> Capture:
    """Open a capture. Raises as `open_capture`, with the option `field` as the field of what is none."""
    try:
        return open_capture(path)
    except (CaptureError, CameraError) as error:
        error.field = field if error.index is None and error.field in ("capture", "cameras") else error.field
        raise
