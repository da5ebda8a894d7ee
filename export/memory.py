"""Lack of memory during an export as an error with its cure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from gapmes.model.allocation import lacks_memory

CURE = "take a smaller --size, or a machine with more memory"
_BYTES = re.compile(r"allocate (\d+) bytes|buffer of size (\d+)")


class OutOfMemory(RuntimeError):
    """An export needs more memory than the machine gives it."""


@contextmanager
def enough_memory(height: int, width: int) -> Iterator[None]:
    """Raises `OutOfMemory` that names the size where the block fails for lack of memory."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not lacks_memory(error):
            raise
        raise OutOfMemory(f"not enough memory to export for {height}x{width} px{_asked(str(error))}: {CURE}") from error


def _asked(text: str) -> str:
    found = _BYTES.search(text)
    return f" ({found[1] or found[2]} bytes in one piece were asked for)" if found else ""
