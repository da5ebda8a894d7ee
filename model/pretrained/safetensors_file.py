"""Reading safetensors files, and what is wrong with one that cannot be read, with both numbers."""

from __future__ import annotations

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from torch import Tensor

from ..weights_file import CheckpointError

_LENGTH_BYTES = 8  # before the header: its length, little-endian
_LONGEST_HEADER = 100_000_000  # bytes, the limit of the format
_AGAIN = "download or copy it again"


class NotSafetensors(CheckpointError):
    """A file that is not in the format, or damaged, or cannot be read for another reason."""


def read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata. Raises `NotSafetensors`."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise NotSafetensors(unreadable(path, error)) from error


def read_safetensors_metadata(path: Path) -> dict[str, str]:
    """The metadata alone. Raises `NotSafetensors`."""
    try:
        with safe_open(path, framework="pt") as file:
            return dict(file.metadata() or {})
    except (OSError, SafetensorError) as error:
        raise NotSafetensors(unreadable(path, error)) from error


def unreadable(path: Path, error: Exception) -> str:
    """Why `path` cannot be read, with the likely cure."""
    if isinstance(error, FileNotFoundError):
        return f"{path}: no such file"
    said = f"{path} cannot be read as safetensors: "
    if "Dtype not understood" in str(error):  # in the format, and no kind of torch's
        return f"{said}torch lacks a kind of numbers in it ({error}); save its tensors as float32, float16 or bfloat16"
    try:
        size, needed = _sizes(path)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return f"{said}{error}; it is another kind of file, or damaged: {_AGAIN}"
    if size < needed:
        return f"{said}it is cut short, with {size} bytes of the {needed} that its header states; {_AGAIN}"
    if size > needed:
        return f"{said}it has {size} bytes, and its header states {needed}; {_AGAIN}"
    return f"{said}{error}; it is damaged: {_AGAIN}"


def _sizes(path: Path) -> tuple[int, int]:
    """Bytes that a file has, and that its header states. Raises `ValueError` and others where there is no header."""
    size = path.stat().st_size
    with path.open("rb") as file:
        length = int.from_bytes(file.read(_LENGTH_BYTES), "little")
        if not 0 < length <= min(_LONGEST_HEADER, size - _LENGTH_BYTES):
            raise ValueError(f"a header of {length} bytes")
        header = json.loads(file.read(length))
    ends = [entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"]
    return size, _LENGTH_BYTES + length + max(ends, default=0)
