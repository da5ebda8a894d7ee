"""Lower thread priority for reconstructions, so that interactive pictures are drawn first."""

from __future__ import annotations

import contextlib
import os
import sys
import threading

NICE = 5  # a third of the time of a thread with nice 0, by Linux's weights; all of it when no other is ready


def give_way() -> None:
    """Lower the priority of the calling thread and of those that it starts. Only Linux has priorities per thread."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
