"""Which files this process has open, and that it has as many as it may have."""

from __future__ import annotations

import gc
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def no_file_left(but: int = 0) -> Iterator[None]:
    """This process can open no further file, or only so many. Garbage is collected before, and not meanwhile: it holds
    files, and would make room for others."""
    gc.collect()
    before, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken = [os.open(os.devnull, os.O_RDONLY) for _ in range(but + 1)]
    gc.disable()
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(taken) + 1, most))
        with suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        for _ in range(but):
            os.close(taken.pop())
        yield
    finally:
        gc.enable()
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, most))


def open_below(folder: Path) -> int:
    """How many files of a folder, also deleted ones, this process has open; other threads may open others meanwhile."""
    count = 0
    for handle in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            count += os.readlink(handle).startswith(f"{folder}/")
    return count
