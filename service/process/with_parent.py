"""A process that works for another one does not outlive it: nobody would read what it finds."""

from __future__ import annotations

import os
import threading
import time

POLL_SECONDS = 1.0


def end_with_parent(parent: int) -> None:
    """From now on this process ends when its parent, of this number, does or has done, however that ends."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)
