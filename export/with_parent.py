"""A process that works for another one does not outlive it: nobody would read what it finds."""

from __future__ import annotations

import os
import threading
import time

POLL_SECONDS = 1.0


def end_with_parent() -> None:
    """From now on this process ends when its parent does, however that ends; one that has ended before is missed."""
    threading.Thread(target=_watch, args=(os.getppid(),), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)
