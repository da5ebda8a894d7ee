"""How many threads this process may use."""

from __future__ import annotations

import os


def available_threads() -> int:
    """How many CPUs this process may run on; all of the machine's where the system does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
