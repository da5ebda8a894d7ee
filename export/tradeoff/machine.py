"""The machine that a report was made on: processor, instruction sets that matter, threads, versions."""

from __future__ import annotations

import platform
from importlib.metadata import version

from gapmes.service.process.machine import processor
from gapmes.service.process.threads import available_threads

from .schema import Machine

PACKAGES = ("gapmes", "numpy", "numba", "onnxruntime", "torch")


def this_machine(threads: int | None) -> Machine:
    """Processor and flags as Linux tells them; elsewhere only what Python knows."""
    cpu, flags = processor()
    return Machine(
        cpu=cpu,
        flags=flags,
        threads=threads or available_threads(),
        versions={"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    )
