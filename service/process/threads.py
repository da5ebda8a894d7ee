"""Number of threads to use: the CPUs of this process, or the CPU limit of its container if that is lower."""

from __future__ import annotations

import math
import os
from pathlib import Path

from .control_group import MOUNT, PROCESS, cpu_limit

MAX_THREADS = 1024  # that can be asked for: each has a stack of its own


def available_threads(process: Path = PROCESS, mount: Path = MOUNT) -> int:
    """Number of CPUs that this process may run on (all, if the system does not tell), or the limit of its control
    group, rounded up, if that is lower."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = cpu_limit(process, mount)
    return cpus if limit is None else max(1, min(cpus, math.ceil(limit)))
