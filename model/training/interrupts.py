"""Starting processes that the interrupt of a terminal, which its whole process group hears, does not reach."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes started within ignore the SIGINT that a terminal sends to the whole group. In the parent it is deferred
    to the end of the block."""
    resource_tracker.ensure_running()  # if it were started later, that would unblock SIGINT
    heard: list[int] = []
    usual = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()  # only the main thread may set signal handlers
    if in_charge := main and usual is not None:
        signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if in_charge:
            signal.signal(signal.SIGINT, usual)
        if heard:
            signal.raise_signal(signal.SIGINT)
