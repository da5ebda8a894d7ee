"""What a command leaves behind that a signal ends: nothing that is half written, and a terminal as it was.

The signals raise no exception, which would come at any place: within a lock of the library that nobody opens then, so
that the command would never end.
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
    """Within the block `path`, a file or a folder, goes if the process is ended by a signal; it need not exist yet."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


@contextmanager
def done_at_the_end(action: Callable[[], None]) -> Iterator[None]:
    """Within the block `action` is called if the process is ended by a signal; it must take no lock."""
    _last.append(action)
    try:
        yield
    finally:
        _last.remove(action)


@contextmanager
def ended_in_order() -> Iterator[None]:
    """Within the block the first of SIGNALS removes what is unfinished, does what is to be done at the end, then ends
    the process as it always would. Who has one ignored, such as nohup, keeps that. Outside the main thread, which alone
    hears of signals, nothing changes."""
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
