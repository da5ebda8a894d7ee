"""Threads that give way: a scene may take a moment longer, a picture is looked at while it is drawn."""

from __future__ import annotations

import contextlib
import os
import sys
import threading

NICE = 5  # by Linux's weights a third of the time of a thread that does not give way; all of it where nobody wants any


def give_way() -> None:
    """Lower the priority of the calling thread and of those that it starts; Linux alone has one for each thread."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
