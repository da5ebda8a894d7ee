"""The number of passes of `fading.py`, checked without importing that module, which loads the splatter."""

from __future__ import annotations

from ..arguments import shown, whole_number
from ..errors import InputError

DEFAULT_PASSES = 4  # each gains less than the one before
MAX_PASSES = 8


def checked_passes(passes: int) -> int:
    """As `int`. Raises `InputError` unless it is a whole number from 0 (no fading) to MAX_PASSES."""
    count = whole_number(passes)
    if count is None or not 0 <= count <= MAX_PASSES:
        raise InputError(f"is {shown(passes)}, need a whole number from 0 to {MAX_PASSES}", field="fade")
    return count
