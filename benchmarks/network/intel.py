"""Make MKL, which torch computes with, take an AMD processor for Intel's: on others it takes a slower path.

A function of MKL gives the answer, and a preloaded library may replace it. Torch on an AMD processor then shows what
its kernels can do. This is for comparison only, so that no claimed ratio comes from MKL's choice of path alone.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

SOURCE = "int mkl_serv_intel_cpu_true(void) { return 1; }\n"


def amd() -> bool:
    info = Path("/proc/cpuinfo")
    return info.is_file() and "AuthenticAMD" in info.read_text(errors="replace")


def told_intel(folder: Path) -> dict[str, str]:
    """Environment in which MKL takes an AMD processor for Intel's; empty for others, or without Linux or compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not amd() or compiler is None or platform.system() != "Linux":
        return {}
    source, library = folder / "intel.c", folder / "intel.so"
    source.write_text(SOURCE)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return {"LD_PRELOAD": str(library)}
