"""Measure one scene: every renderer in turns, with medians, stages, operation counts and agreement."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import render

from .plain import PlainRenderer

# Operations for a pair of a Gaussian and a pixel, a multiply-add counted as two: distance 4, power of two 13, cut and
# transmittance 3, colours 6. What rows or columns of a block share is left out.
FLOP_PER_PAIR = 26
PLAIN_UP_TO = 500_000  # splats; the plain renderer would take minutes beyond
Draw = Callable[[Camera], NDArray[np.floating]]


@dataclass(frozen=True)
class Other:
    """Another renderer: its name, and a function that prepares a scene for it."""

    name: str
    make: Callable[[Gaussians, int], Draw]


@dataclass(frozen=True)
class Row:
    """The medians of one scene."""

    name: str
    count: int
    px: int  # width of the picture
    milliseconds: float
    ratio: float | None  # plain renderer's time over ours; None where it did not run
    scaling: float | None  # one thread's time over that of two; None where all have one thread
    harmonics: float | None  # time over that with degree 0 alone, where the scene has more
    pairs: float  # millions, of a Gaussian and a pixel
    share: float  # of the measured float32 peak, in the blend stage
    agreement: float | None  # dB to the plain renderer
    stages: dict[str, float]  # ms
    others: dict[str, tuple[float, float]]  # time over ours, dB between the pictures

    def cells(self) -> dict[str, str]:
        """The table's row."""
        cells = {"scene": self.name, "px": str(self.px), "ms": f"{self.milliseconds:.1f}"}
        cells["x plain"] = "" if self.ratio is None else f"{self.ratio:.1f}"
        cells["one to two threads"] = "" if self.scaling is None else f"{self.scaling:.2f}"
        cells |= {stage: f"{value:.1f}" for stage, value in self.stages.items()}
        cells |= {"M pairs": f"{self.pairs:.1f}", "blend / peak": f"{100 * self.share:.0f} %"}
        cells["dB to plain"] = "" if self.agreement is None else f"{self.agreement:.0f}"
        for name, (ratio, agreement) in self.others.items():
            cells[f"x {name}"], cells[f"dB to {name}"] = f"{ratio:.1f}", f"{agreement:.0f}"
        return cells


def measure(
    name: str, gaussians: Gaussians, view: Camera, repeats: int, threads: int, others: Sequence[Other], peak: float
) -> Row:
    """Draw `repeats` times with each renderer in turns; `peak` in GFLOP/s."""
    stages: list[dict[str, float]] = []

    def ours(camera: Camera) -> NDArray[np.floating]:
        image = render(gaussians, camera, threads=threads, outputs=())
        stages.append(image.stats["seconds"])
        return image.rgb

    runs: dict[str, Draw] = {"ours": ours}
    if threads > 1:
        runs["one"] = lambda camera: render(gaussians, camera, threads=1, outputs=()).rgb
    if threads > 2:
        runs["two"] = lambda camera: render(gaussians, camera, threads=2, outputs=()).rgb
    if gaussians.sh_degree > 0:
        runs["degree 0"] = lambda camera: render(gaussians, camera, threads=threads, outputs=(), sh_degree=0).rgb
    if len(gaussians) <= PLAIN_UP_TO:
        runs["plain"] = PlainRenderer(gaussians, threads)
    for other in others:
        runs[other.name] = other.make(gaussians, threads)
    pictures = {key: draw(view) for key, draw in runs.items()}
    stages.clear()
    seconds: dict[str, list[float]] = {key: [] for key in runs}
    for _ in range(repeats):
        for key, draw in runs.items():
            draw(view)  # not timed: the renderer before has left the caches full of its own data
            cold = len(stages)
            start = time.perf_counter()
            draw(view)
            seconds[key].append(time.perf_counter() - start)
            if key == "ours":
                del stages[cold - 1]
    median = {key: statistics.median(values) for key, values in seconds.items()}

    def agreement(key: str) -> float:
        difference = np.asarray(pictures[key], np.float64) - pictures["ours"]
        return float(-10 * np.log10((difference**2).mean() + 1e-30))

    pairs = render(gaussians, view, threads=threads, outputs=("pairs",)).stats["pairs"]
    middle = {stage: statistics.median(row[stage] for row in stages) for stage in stages[0]}
    return Row(
        name,
        len(gaussians),
        view.width,
        1e3 * median["ours"],
        median["plain"] / median["ours"] if "plain" in runs else None,
        median["one"] / median["two" if threads > 2 else "ours"] if threads > 1 else None,
        median["ours"] / median["degree 0"] if "degree 0" in runs else None,
        pairs / 1e6,
        pairs * FLOP_PER_PAIR / middle["blend"] / (1e9 * peak),
        agreement("plain") if "plain" in runs else None,
        {stage: 1e3 * value for stage, value in middle.items() if stage != "prepare"},
        {other.name: (median[other.name] / median["ours"], agreement(other.name)) for other in others},
    )
