"""Ending a helper process together with its parent."""

from __future__ import annotations

import os
import threading
import time

POLL_SECONDS = 1.0


def end_with_parent(parent: int) -> None:
    """End this process, with status 1, once its parent with this process id has ended, however it ends."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)
