"""What runs in a process of its own: reconstructions as the service does them, timed, with peak memory."""

from __future__ import annotations

import multiprocessing
import resource
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapmes.service.budget import Budget
from gapmes.service.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.images import Photo


@dataclass(frozen=True, eq=False)
class Given:
    """The inputs of a reconstruction."""

    photos: Sequence[Photo]
    cameras: Sequence[Camera]
    near: float | None
    far: float | None


@dataclass(frozen=True, eq=False)
class Timed:
    """Reconstructions of several scenes; times are medians over repeats of the first, in seconds."""

    gaussians: list[Gaussians]
    documents: list[dict[str, Any]]
    stages: dict[str, float]
    seconds: float
    peak_mb: float


def peak_mb() -> float:
    """Most memory resident so far: Linux tells it of this program; elsewhere it may be the parent's."""
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def timed(model: Path | None, given: Sequence[Given], budget: Budget, repeats: int, threads: int | None) -> Timed:
    """In a new process, which has loaded nothing but the service."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_timed, model, given, budget, repeats, threads).result()


def _timed(model: Path | None, given: Sequence[Given], budget: Budget, repeats: int, threads: int | None) -> Timed:
    from gapmes.service.reconstruct import Reconstructor

    reconstructor = Reconstructor(model, threads=threads)

    def once(scene: Given) -> Any:
        return reconstructor.reconstruct(
            list(scene.photos), scene.cameras, near=scene.near, far=scene.far, trust_poses=True, budget=budget
        )

    measured = [once(given[0]).document["timings"] for _ in range(repeats + 1)][1:]
    peak = peak_mb()
    scenes = [once(scene) for scene in given]
    stages = {name: statistics.median(row[name] for row in measured) for name in measured[0]}
    whole = statistics.median(sum(row.values()) for row in measured)
    return Timed([s.gaussians for s in scenes], [s.document for s in scenes], stages, whole, peak)
