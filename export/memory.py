"""Lack of memory, told from the words of torch, onnxruntime and Python, as an error with its cure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

CURE = "take a smaller --size, or a machine with more memory"
_WORDS = re.compile(
    r"can't allocate memory|not enough memory|(cannot|failed to|unable to) allocate|bad_alloc|MemoryError",
    re.IGNORECASE,
)
_BYTES = re.compile(r"allocate (\d+) bytes|buffer of size (\d+)")


class OutOfMemory(RuntimeError):
    """An export needs more memory than the machine gives it."""


@contextmanager
def enough_memory(height: int, width: int) -> Iterator[None]:
    """Raises `OutOfMemory` that names the size where the block fails for lack of memory."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not lacks_memory(str(error)):
            raise
        raise OutOfMemory(f"not enough memory to export for {height}x{width} px{_asked(str(error))}: {CURE}") from error


def lacks_memory(text: str) -> bool:
    """Whether an error's text, or the last line of a traceback, tells of a failed allocation."""
    return _WORDS.search(text) is not None


def _asked(text: str) -> str:
    found = _BYTES.search(text)
    return f" ({found[1] or found[2]} bytes in one piece were asked for)" if found else ""
