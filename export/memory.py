"""Lack of memory during an export or a measurement as an error with its cure."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gapmes.model.allocation import lacks_memory
from gapmes.service.errors import GapmesError

CURE = "take a smaller --size, or a machine with more memory"
LACKING = 4  # exit status of a process that ends for lack of memory
_BYTES = re.compile(r"allocate (\d+) bytes|buffer of size (\d+)")


class OutOfMemory(RuntimeError):
    """An export or a measurement needs more memory than the machine gives it."""


@contextmanager
def enough_memory(to: str, cure: str = CURE) -> Iterator[None]:
    """Raises `OutOfMemory`, "not enough memory to ...", where the block fails for lack of memory."""
    try:
        yield
    except (GapmesError, OutOfMemory, ValueError):  # they have said what they lack
        raise
    except Exception as error:
        if not lacks_memory(error):
            raise
        raise OutOfMemory(f"not enough memory to {to}{_asked(str(error))}: {cure}") from error


@contextmanager
def ended_for_lack_of_memory() -> Iterator[None]:
    """In a process of its own: it ends with the status `LACKING` where the block fails for lack of memory."""
    try:
        yield
    except Exception as error:
        if not lacks_memory(error):
            raise
        sys.exit(LACKING)


def _asked(text: str) -> str:
    found = _BYTES.search(text)
    return f" ({found[1] or found[2]} bytes in one piece were asked for)" if found else ""
