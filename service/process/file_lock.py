"""Shared and exclusive file locks between processes on one file system; a crash releases them."""

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
    """Hold a shared lock; waits while another process holds an exclusive one."""
    return _held(path, fcntl.LOCK_SH)


def exclusive(path: Path) -> AbstractContextManager[None]:
    """Hold an exclusive lock; waits until nobody else holds one."""
    return _held(path, fcntl.LOCK_EX)


@contextmanager
def exclusive_if_free(path: Path) -> Iterator[bool]:
    """Hold an exclusive lock if it is free; yields whether it was, and never waits."""
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
