"""The processor as Linux tells it: its name, and the instruction sets that matter here."""

from __future__ import annotations

import platform
from pathlib import Path

FLAGS = ("avx2", "fma", "avx512f", "avx512_vnni", "avx512_bf16", "avx_vnni", "amx_int8", "amx_bf16", "asimd", "bf16")


def processor() -> tuple[str, list[str]]:
    """Name and those of `FLAGS` that it has; elsewhere than on Linux only the name that Python knows."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8", errors="replace").splitlines() if info.is_file() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    have = set(fields.get("flags", fields.get("Features", "")).split())
    name = fields.get("model name") or platform.processor() or platform.machine()
    return name, [flag for flag in FLAGS if flag in have]


def available_memory_mb() -> float | None:
    """What Linux would give to a new process without swapping; None elsewhere."""
    info = Path("/proc/meminfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((float(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable")), None)
