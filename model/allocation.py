"""Failed allocations of memory, told from the errors of torch, onnxruntime and Python."""

from __future__ import annotations

import re

_WORDS = re.compile(
    r"can't allocate memory|not enough memory|(cannot|failed to|unable to) allocate|bad_alloc|MemoryError",
    re.IGNORECASE,
)


def lacks_memory(error: BaseException | str) -> bool:
    """Whether an error, its text, or the last line of its traceback tells of a failed allocation."""
    return isinstance(error, MemoryError) or _WORDS.search(str(error)) is not None
