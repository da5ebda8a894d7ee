"""The limits of this process's control group (version 2 or 1), such as those of a container: CPUs and memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

PROCESS, MOUNT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
UNLIMITED = 1 << 60  # bytes from which version 1 means no limit: it tells its largest number of pages then


def cpu_limit(process: Path = PROCESS, mount: Path = MOUNT) -> float | None:
    """The lowest CPU limit of the group and its ancestors, in CPUs; None without a limit."""
    return _lowest("cpu", _cpus_2, _cpus_1, process, mount)


def memory_limit_mb(process: Path = PROCESS, mount: Path = MOUNT) -> float | None:
    """The lowest limit of memory of the group and its ancestors, in MiB; None without a limit."""
    return _lowest("memory", _memory_2, _memory_1, process, mount)


def _lowest(
    controller: str,
    version_2: Callable[[Path], float | None],
    version_1: Callable[[Path], float | None],
    process: Path,
    mount: Path,
) -> float | None:
    """The lowest limit of a group and its ancestors. Inside a container its own group is mounted as the root of
    `mount`, whatever path `process` has."""
    try:
        lines = process.read_text().splitlines()
    except OSError:
        return None
    limits = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            limits += [version_2(folder) for folder in _upwards(mount, path)]
        elif controller in controllers.split(","):
            for name in (controllers, controller):
                limits += [version_1(folder) for folder in _upwards(mount / name, path)]
    return min((limit for limit in limits if limit is not None), default=None)


def _upwards(root: Path, path: str) -> list[Path]:
    """The folder of the group at `path`, those of its ancestors, and `root`."""
    parts = [part for part in path.split("/") if part and part != ".."]
    return [root.joinpath(*parts[:length]) for length in range(len(parts), -1, -1)]


def _cpus_2(folder: Path) -> float | None:
    try:
        quota, period = (folder / "cpu.max").read_text().split()
    except (OSError, ValueError):
        return None
    return None if quota == "max" else int(quota) / int(period)


def _cpus_1(folder: Path) -> float | None:
    try:
        quota, period = (int((folder / f"cpu.cfs_{name}_us").read_text()) for name in ("quota", "period"))
    except (OSError, ValueError):
        return None
    return None if quota <= 0 else quota / period


def _memory_2(folder: Path) -> float | None:
    return _mebibytes(folder / "memory.max")


def _memory_1(folder: Path) -> float | None:
    return _mebibytes(folder / "memory.limit_in_bytes")


def _mebibytes(file: Path) -> float | None:
    try:
        limit = int(file.read_text())
    except (OSError, ValueError):  # "max"
        return None
    return limit / 2**20 if limit < UNLIMITED else None
