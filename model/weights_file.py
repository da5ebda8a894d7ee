"""What all readers of weights share: their error, how it lists names, and a file's sha256."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

SHOWN = 5  # names in a message


class CheckpointError(ValueError):
    """A file that holds no weights, that is not a checkpoint of ours, or that does not fit what it is loaded into."""


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def some(names: Sequence[str]) -> str:
    """The first names of many, for a message."""
    return ", ".join(names[:SHOWN]) + (", …" if len(names) > SHOWN else "")
