"""Number of threads to use: the CPUs of this process, or the CPU limit of its container if that is lower."""

from __future__ import annotations

import math
import os
from pathlib import Path

MAX_THREADS = 1024  # that can be asked for: each has a stack of its own
PROCESS, MOUNT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def available_threads(process: Path = PROCESS, mount: Path = MOUNT) -> int:
    """Number of CPUs that this process may run on (all, if the system does not tell), or the limit of its control
    group, rounded up, if that is lower."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = cpu_limit(process, mount)
    return cpus if limit is None else max(1, min(cpus, math.ceil(limit)))


def cpu_limit(process: Path = PROCESS, mount: Path = MOUNT) -> float | None:
    """The lowest CPU limit of this process's control group (version 2 or 1) and its ancestors, in CPUs; None without a
    limit.

    Inside a container its own group is mounted as the root of `mount`, whatever path `process` has.
    """
    try:
        lines = process.read_text().splitlines()
    except OSError:
        return None
    limits = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            limits += [_version_2(folder) for folder in _upwards(mount, path)]
        elif "cpu" in controllers.split(","):
            for name in (controllers, "cpu"):
                limits += [_version_1(folder) for folder in _upwards(mount / name, path)]
    return min((limit for limit in limits if limit is not None), default=None)


def _upwards(root: Path, path: str) -> list[Path]:
    """The folder of the group at `path`, those of its ancestors, and `root`."""
    parts = [part for part in path.split("/") if part and part != ".."]
    return [root.joinpath(*parts[:length]) for length in range(len(parts), -1, -1)]


def _version_2(folder: Path) -> float | None:
    try:
        quota, period = (folder / "cpu.max").read_text().split()
    except (OSError, ValueError):
        return None
    return None if quota == "max" else int(quota) / int(period)


def _version_1(folder: Path) -> float | None:
    try:
        quota, period = (int((folder / f"cpu.cfs_{name}_us").read_text()) for name in ("quota", "period"))
    except (OSError, ValueError):
        return None
    return None if quota <= 0 else quota / period
