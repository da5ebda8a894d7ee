"""Commands whose extra `export` may be missing or outdated: one line that says what to install, no traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

EXTRA = "gapmes[export]"


@contextmanager
def imports_of(command: str) -> Iterator[None]:
    """End the process with status 1 where torch, onnx and the like cannot be imported in the block."""
    try:
        yield
    except ImportError as error:
        if error.name is None or error.name.partition(".")[0] == "gapmes":
            raise
        if isinstance(error, ModuleNotFoundError):
            told = f"needs {error.name}: pip install '{EXTRA}'"
        else:  # it is there, and lacks a name
            told = f"cannot use the installed {error.name} ({error}): pip install --upgrade '{EXTRA}'"
        sys.stderr.write(f"refused: {command} {told}\n")
        sys.exit(1)
