"""The signals that end a command, as exceptions: it leaves no half of a file behind."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def unwound() -> Iterator[None]:
    """Within the block the first of these signals ends the process as `sys.exit` does, with 128 and its number; a
    second one ends it at once. Who has one ignored, such as nohup, keeps that. Outside the main thread, which alone
    hears of signals, nothing changes."""
    main = threading.current_thread() is threading.main_thread()
    taken = [number for number in SIGNALS if main and signal.getsignal(number) == signal.SIG_DFL]

    def as_before() -> None:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)

    def end(number: int, _: Any) -> None:
        as_before()
        sys.exit(128 + number)

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        as_before()
