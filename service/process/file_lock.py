"""Locks between processes on one file system: many may share one, or one may have it alone; a crash releases it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path


@contextmanager
def _held(path: Path, kind: int) -> Iterator[None]:
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(handle, kind)
        yield
    finally:
        os.close(handle)


def shared(path: Path) -> AbstractContextManager[None]:
    """Hold the lock together with others; waits for one that has it alone."""
    return _held(path, fcntl.LOCK_SH)


def exclusive(path: Path) -> AbstractContextManager[None]:
    """Hold the lock alone; waits until nobody else has it."""
    return _held(path, fcntl.LOCK_EX)


@contextmanager
def exclusive_if_free(path: Path) -> Iterator[bool]:
    """Hold the lock alone, if nobody has it: yields whether it was free, and never waits."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = True
        except BlockingIOError:
            free = False
        yield free
    finally:
        os.close(handle)
