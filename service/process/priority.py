"""Lower thread priority for reconstructions, so that interactive pictures are drawn first."""

from __future__ import annotations

import contextlib
import os
import sys
import threading

NICE = 5  # more than the main thread: a third of its time, by Linux's weights; all of it when no other is ready


def give_way() -> None:
    """Lower the priority of the calling thread, and of those that it starts, below that of the main thread. Only Linux
    has priorities per thread."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            main = os.getpriority(os.PRIO_PROCESS, os.getpid())
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), main + NICE)
