"""What a command leaves behind that a signal ends: nothing that is half written.

The signals raise no exception, which would come at any place: within a lock of the library that nobody opens then, so
that the command would never end.
"""

from __future__ import annotations

import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
_unfinished: set[Path] = set()


@contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """Within the block `path`, a file or a folder, goes if the process is ended by a signal; it need not exist yet."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


@contextmanager
def ended_in_order() -> Iterator[None]:
    """Within the block the first of SIGNALS removes what is unfinished, then ends the process as it always would. Who
    has one ignored, such as nohup, keeps that. Outside the main thread, which alone hears of signals, nothing changes.
    """
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
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)
