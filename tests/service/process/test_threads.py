"""Threads and memory by the container's limit: both versions of cgroups, limits of parent groups, and no limit."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gapmes.service.process.control_group import cpu_limit, memory_limit_mb
from gapmes.service.process.threads import available_threads


def group(root: Path, files: dict[str, str], lines: str) -> tuple[Path, Path]:
    process, mount = root / "self", root / "cgroup"
    process.write_text(lines)
    for name, text in files.items():
        (mount / name).parent.mkdir(parents=True, exist_ok=True)
        (mount / name).write_text(text)
    return process, mount


@pytest.mark.parametrize(
    ("files", "lines", "limit"),
    [
        ({"cpu.max": "150000 100000\n"}, "0::/\n", 1.5),
        ({"cpu.max": "max 100000\n"}, "0::/\n", None),
        ({"cpu.max": "50000 100000\n"}, "0::/docker/abc\n", 0.5),  # in a container the own group is the root
        ({"a/b/cpu.max": "max 100000", "a/cpu.max": "300000 100000"}, "0::/a/b\n", 3.0),
        ({"a/b/cpu.max": "100000 100000", "a/cpu.max": "300000 100000"}, "0::/a/b\n", 1.0),
        ({"a/cpu.max": "100000 100000"}, "0::/../a\n", 1.0),
        ({"cpu/cpu.cfs_quota_us": "250000", "cpu/cpu.cfs_period_us": "100000"}, "4:memory:/x\n3:cpu:/x\n", 2.5),
        (
            {"cpu,cpuacct/x/cpu.cfs_quota_us": "50000", "cpu,cpuacct/x/cpu.cfs_period_us": "100000"},
            "3:cpu,cpuacct:/x\n",
            0.5,
        ),
        ({"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, "3:cpu:/\n", None),
        ({"cpu.max": "nonsense"}, "0::/\n", None),
        ({}, "0::/\n", None),
        ({}, "", None),
    ],
)  # fmt: skip
def test_limits(tmp_path: Path, files: dict[str, str], lines: str, limit: float | None) -> None:
    process, mount = group(tmp_path, files, lines)
    assert cpu_limit(process, mount) == limit
    cpus = len(os.sched_getaffinity(0))
    expected = cpus if limit is None else min(cpus, max(1, -int(-limit // 1)))
    assert available_threads(process, mount) == expected


@pytest.mark.parametrize(
    ("files", "lines", "limit"),
    [
        ({"memory.max": "2147483648\n"}, "0::/\n", 2048.0),
        ({"memory.max": "max\n"}, "0::/\n", None),
        ({"a/memory.max": "3145728", "memory.max": "1048576"}, "0::/a\n", 1.0),
        ({"memory/x/memory.limit_in_bytes": "1048576"}, "4:memory:/x\n3:cpu:/y\n", 1.0),
        ({"memory/memory.limit_in_bytes": "9223372036854771712"}, "4:memory:/\n", None),
        ({}, "0::/\n", None),
    ],
)  # fmt: skip
def test_limits_of_memory(tmp_path: Path, files: dict[str, str], lines: str, limit: float | None) -> None:
    assert memory_limit_mb(*group(tmp_path, files, lines)) == limit


def test_a_system_without_control_groups(tmp_path: Path) -> None:
    assert cpu_limit(tmp_path / "none", tmp_path) is None
    assert available_threads(tmp_path / "none", tmp_path) == len(os.sched_getaffinity(0))


def test_this_machine() -> None:
    assert 1 <= available_threads() <= len(os.sched_getaffinity(0))
