"""Reconstructions in separate processes, under the C library's own allocator: times and peak memory."""

from __future__ import annotations

import os
import pickle
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.photographs.images import Photo
from gapmes.service.process.with_parent import end_with_parent

from ..memory import LACKING, ended_for_lack_of_memory

if TYPE_CHECKING:
    from gapmes.service.reconstruct import Reconstructor


CURE = "take --quick, which measures less, or a machine with more memory"
CHILD = "import sys; from gapmes.export.tradeoff.child import answer; answer(*sys.argv[1:])"


class ChildFailed(RuntimeError):
    """A process of the report ended without a result; its own messages are on stderr."""

    def __init__(self, what: str, status: int) -> None:
        if status == LACKING:
            told = f"{what} had not enough memory: {CURE}"
        elif status == -signal.SIGKILL:
            told = f"{what} was ended by SIGKILL; lack of memory may be why: {CURE}"
        else:
            told = f"{what} ended with status {status}, need 0; its last words are above"
        super().__init__(told)


@dataclass(frozen=True, eq=False)
class Given:
    """The inputs of a reconstruction."""

    photos: Sequence[Photo]
    cameras: Sequence[Camera]
    near: float | None
    far: float | None


@dataclass(frozen=True, eq=False)
class Timed:
    """Reconstructions of several scenes; times are medians over repeats of the first, in seconds: of the stages, and
    their sum."""

    gaussians: list[Gaussians]
    documents: list[dict[str, Any]]
    stages: dict[str, float]
    seconds: float
    peak_mb: float


def peak_mb() -> float:
    """Peak resident memory of this process, MiB; outside of Linux it may include the parent's before the fork."""
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def timed(
    model: Path | None,
    given: Sequence[Given],
    budget: Budget,
    repeats: int,
    threads: int | None,
    fade: int = DEFAULT_PASSES,
) -> Timed:
    """Measure in new processes that load only the service: one reconstructs the first scene `repeats` times, for times
    and peak memory, the other reconstructs all scenes. Raises `ChildFailed`."""
    times, peak = _in_child(_measured, model, given[0], budget, repeats, threads, fade)
    scenes = _in_child(_reconstructed, model, given, budget, threads, fade)
    return Timed([s for s, _ in scenes], [d for _, d in scenes], times, sum(times.values()), peak)


def _in_child(work: Callable[..., Any], *arguments: object) -> Any:
    """work(*arguments) in a new process; `multiprocessing` would import the main program there, and with it torch.

    Raises `ChildFailed`.
    """
    with tempfile.TemporaryDirectory() as folder:
        asked, told = Path(folder, "asked"), Path(folder, "told")
        asked.write_bytes(pickle.dumps((work, arguments)))
        command = [sys.executable, "-c", CHILD, str(asked), str(told), str(os.getpid())]
        status = subprocess.run(command, check=False).returncode
        if status:
            raise ChildFailed(f"the process that measures {work.__name__.strip('_')}", status)
        return pickle.loads(told.read_bytes())


def answer(asked: str, told: str, parent: str) -> None:
    """Entry point of the child, which ends when its parent does."""
    end_with_parent(int(parent))
    with ended_for_lack_of_memory():
        work, arguments = pickle.loads(Path(asked).read_bytes())
        Path(told).write_bytes(pickle.dumps(work(*arguments)))


def _measured(
    model: Path | None, scene: Given, budget: Budget, repeats: int, threads: int | None, fade: int
) -> tuple[dict[str, float], float]:
    """Medians of the stages, and the peak memory."""
    from gapmes.service.reconstruct import Reconstructor

    reconstructor = Reconstructor(model, threads=threads)
    measured = [_once(reconstructor, scene, budget, fade)[1]["timings"] for _ in range(repeats + 1)][1:]
    return {name: statistics.median(row[name] for row in measured) for name in measured[0]}, peak_mb()


def _reconstructed(
    model: Path | None, given: Sequence[Given], budget: Budget, threads: int | None, fade: int
) -> list[tuple[Gaussians, dict[str, Any]]]:
    from gapmes.service.reconstruct import Reconstructor

    reconstructor = Reconstructor(model, threads=threads)
    return [_once(reconstructor, scene, budget, fade) for scene in given]


def _once(reconstructor: Reconstructor, scene: Given, budget: Budget, fade: int) -> tuple[Gaussians, dict[str, Any]]:
    found = reconstructor.reconstruct(
        list(scene.photos),
        scene.cameras,
        near=scene.near,
        far=scene.far,
        trust_poses=True,
        budget=budget,
        leave_one_out=0,
        fade=fade,
        whole=False,
    )
    return found.gaussians, found.document
