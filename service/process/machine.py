"""The processor and the free memory, as Linux reports them."""

from __future__ import annotations

import platform
from pathlib import Path

FLAGS = ("avx2", "fma", "avx512f", "avx512_vnni", "avx512_bf16", "avx_vnni", "amx_int8", "amx_bf16", "asimd", "bf16")


def processor() -> tuple[str, list[str]]:
    """Name of the processor, and the instruction sets of `FLAGS` that it supports; outside Linux the name only."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.is_file() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    have = set(fields.get("flags", fields.get("Features", "")).split())
    name = fields.get("model name") or platform.processor() or platform.machine()
    return name, [flag for flag in FLAGS if flag in have]


def available_memory_mb() -> float | None:
    """Memory in MiB that new processes can use without swapping; None outside Linux."""
    info = Path("/proc/meminfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable")), None)
