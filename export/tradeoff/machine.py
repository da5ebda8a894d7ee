"""The machine that a report was made on: processor, instruction sets that matter, threads, versions."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

from gapmes.service.threads import available_threads

from .schema import Machine

FLAGS = ("avx2", "fma", "avx512f", "avx512_vnni", "avx_vnni", "amx_int8", "amx_bf16", "asimd")
PACKAGES = ("gapmes", "numpy", "numba", "onnxruntime", "torch")


def this_machine(threads: int | None = None) -> Machine:
    """Processor and flags as Linux tells them; elsewhere only what Python knows."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    have = set(fields.get("flags", fields.get("Features", "")).split())
    return Machine(
        cpu=fields.get("model name") or platform.processor() or platform.machine(),
        flags=[flag for flag in FLAGS if flag in have],
        threads=threads or available_threads(),
        versions={"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    )
