"""Shared by all readers of weights: their error, its lists of names, prefixes of names, and a file's sha256."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from pathlib import Path

SHOWN = 5  # names in a message
# What DistributedDataParallel, torch.compile, Lightning and DeepSpeed put before the names of a module within them.
WRAPPERS = ("module.", "_orig_mod.", "model.", "_forward_module.")


class CheckpointError(ValueError):
    """A file that holds no weights, that is not a checkpoint of ours, or that does not fit what it is loaded into."""


def why_no_file(path: Path) -> str:
    """What stands where a file of weights should, for a message."""
    if path.is_dir():
        return f"{path}: is a folder, give the weights file in it"
    return f"{path}: {'is a device or a pipe, need a file' if path.exists() else 'no such file'}"


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def some(names: Sequence[str]) -> str:
    """The first names of many, for a message."""
    return ", ".join(names[:SHOWN]) + (", …" if len(names) > SHOWN else "")


def wrapper_of(names: Collection[str]) -> str:
    """The prefix, of one wrapper or several in each other, that all of these names have; empty where one has none."""
    found = ""
    while names:
        inner = [found + wrapper for wrapper in WRAPPERS if all(name.startswith(found + wrapper) for name in names)]
        if not inner:
            break
        found = inner[0]
    return found
