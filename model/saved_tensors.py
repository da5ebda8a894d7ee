"""Atomic, deterministic writing of safetensors: equal contents give equal bytes, and so an equal sha256."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

_METADATA = "__metadata__"
_LENGTH_BYTES = 8  # before the header: its length, little-endian
_ALIGNMENT = 8  # bytes: the header is padded with spaces to a multiple


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write contiguous CPU tensors with their metadata; the folder is created if it is missing.

    The package safetensors writes metadata in the random order of a hash table, into a file that only its owner may
    read. Here metadata are sorted, and the file has the mode of any new file. Of a symbolic link the target is
    replaced. Raises `OSError`.
    """
    try:
        path = path.resolve()
    except RuntimeError as error:  # of Python 3.11 and 3.12, for links in a circle
        raise OSError(f"{path} cannot be written: {error}") from error
    path.parent.mkdir(parents=True, exist_ok=True)
    shuffled, part = path.with_name(path.name + ".shuffled.part"), path.with_name(path.name + ".part")
    try:
        try:
            save_file(dict(tensors), shuffled, metadata=dict(metadata))
        except SafetensorError as error:
            raise OSError(f"{path} cannot be written: {error}") from error
        with shuffled.open("rb") as source, part.open("wb") as target:
            length = int.from_bytes(source.read(_LENGTH_BYTES), "little")
            header = _in_order(source.read(length))
            target.write(len(header).to_bytes(_LENGTH_BYTES, "little") + header)
            shutil.copyfileobj(source, target)
        os.replace(part, path)
    finally:
        shuffled.unlink(missing_ok=True)
        part.unlink(missing_ok=True)


def _in_order(header: bytes) -> bytes:
    """The same header with sorted metadata; tensors stay in the order of their bytes."""
    entries = json.loads(header)
    entries[_METADATA] = dict(sorted(entries[_METADATA].items()))
    text = json.dumps(entries, ensure_ascii=False, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % _ALIGNMENT)
