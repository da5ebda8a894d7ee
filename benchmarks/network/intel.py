"""MKL, which torch computes with, asks whether the processor is Intel's and takes a slower path where it is not.

The answer is a function of the library that another library may replace: with that, torch on an AMD processor shows
what its kernels can do. For comparison only, so that no ratio is claimed that is MKL's choice of path.
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
    """Environment under which MKL takes the processor for Intel's; empty where it is, or where nothing can compile."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not amd() or compiler is None or platform.system() != "Linux":
        return {}
    source, library = folder / "intel.c", folder / "intel.so"
    source.write_text(SOURCE)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return {"LD_PRELOAD": str(library)}
