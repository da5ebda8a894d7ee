"""Cleanup when a signal ends a command: unfinished files are deleted, and the terminal is restored.

The handlers raise no exception: it could strike anywhere, even inside a lock of a library that would then stay locked,
so that the command would never end.
"""

from __future__ import annotations

import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
_unfinished: set[Path] = set()
_last: list[Callable[[], None]] = []


@contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """During the block `path`, a file or folder, is deleted if a signal ends the process; it need not exist yet."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


@contextmanager
def done_at_the_end(action: Callable[[], None]) -> Iterator[None]:
    """During the block `action` is called if a signal ends the process; it must not take locks."""
    _last.append(action)
    try:
        yield
    finally:
        _last.remove(action)


@contextmanager
def ended_in_order() -> Iterator[None]:
    """During the block the first of SIGNALS deletes unfinished paths and calls the registered actions, then ends the
    process as it would by default. An ignored signal, as under nohup, stays ignored. Outside the main thread, where no
    handlers can be set, nothing changes."""
    main = threading.current_thread() is threading.main_thread()
    taken = [number for number in SIGNALS if main and signal.getsignal(number) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _end(number: int, _: Any) -> None:
    for path in tuple(_unfinished):
        with suppress(OSError):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
    for action in reversed(_last):
        with suppress(OSError):
            action()
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)
