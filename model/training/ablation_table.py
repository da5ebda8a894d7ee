"""What an ablation shows: paired differences to the complete model with their standard errors, as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

COMPLETE = "complete"
# rows of the paper's tables, and what its text says of each against its complete model (SSIM 0.709, PSNR 20.20)
PAPER: dict[str, dict[str, str]] = {
    "Table 5: parts left out": {
        "without-depth": "SSIM -33.3 %",
        "without-experts": "PSNR -21.9 %",
        "without-tasks": "SSIM -34.3 %",
    },
    "Table 6: sensitivity": {
        "tau-0.4": "SSIM 0.682 or more, so at most -3.8 %",
        "tau-0.6": "SSIM 0.682 or more, so at most -3.8 %",
        "experts-4": "a noticeable degradation",
        "experts-8": "SSIM 0.687, so -3.1 %",
        "top-1": "SSIM 0.691, so -2.5 %",
    },
}
# what is compared: field of `Scores`, its title in tables, decimals
SHOWN = (("psnr", "PSNR", 2), ("ssim", "SSIM", 4), ("lpips", "LPIPS", 4), ("depth_error", "depth error", 4))
NONE = "–"  # for a figure that a run was scored without
SAME_SCENE_DB = 1e-3  # figures are rounded to 1e-4 dB; another number of threads may change the last digit


@dataclass(frozen=True, eq=False)
class Scores:
    """One trained variant on the fixed validation scenes; arrays are (N,), one finite number per scene, or `ValueError`
    is raised."""

    parameters: int
    minutes: float
    psnr: F64  # dB, mean over the scene's targets
    ssim: F64
    depth_error: F64  # mean absolute error of normalised inverse depth
    copy_psnr: F64  # dB, the nearer input shown as it is
    lpips: F64 | None = None  # None where it was scored without
    lpips_weights: str | None = None  # the fingerprint of `Lpips`

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray) and (wrong := ~np.isfinite(values)).any():
                scene = int(wrong.argmax())
                raise ValueError(
                    f"{name} of scene {scene} is {values[scene]}, need a finite number: the run has diverged, or its "
                    "weights are damaged; use a new folder and another seed"
                )


@dataclass(frozen=True)
class Paired:
    """A mean difference with its standard errors."""

    mean: float
    scene_error: float  # standard error over scenes, nan for a single scene
    seed_error: float  # standard error over training seeds, nan for a single seed


def paired(values: F64, reference: F64) -> Paired:
    """values - reference, both (seeds, scenes), paired by scene and seed.

    The mean over seeds is taken first: its spread over scenes gives the one error, the spread of the seeds' means the
    other. Raises `ValueError` for different shapes.
    """
    if values.shape != reference.shape or values.ndim != 2:
        raise ValueError(f"values are {values.shape}, reference {reference.shape}, need the same (seeds, scenes)")
    difference = values - reference
    return Paired(
        float(difference.mean()), _standard_error(difference.mean(axis=0)), _standard_error(difference.mean(axis=1))
    )


def _standard_error(values: F64) -> float:
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


# of one variant, by training seed
Runs = Mapping[int, Scores]


def stacked(runs: Runs, seeds: Sequence[int], field: str) -> F64 | None:
    """(seeds, scenes) of one field of `Scores`; None where a run was scored without it."""
    values = [getattr(runs[seed], field) for seed in seeds]
    return None if any(value is None for value in values) else np.stack(values)


def check_comparable(results: Mapping[str, Runs]) -> None:
    """Raise `ValueError` when two runs were scored on different scenes, as they are after a change of the generator, or
    with different weights for LPIPS.

    What the nearer input scores depends on the scenes alone, so it tells.
    """
    runs = [(f"{name} (seed {seed})", scores) for name, by_seed in results.items() for seed, scores in by_seed.items()]
    for name, scores in runs[1:]:
        first, reference = runs[0]
        if scores.copy_psnr.shape != reference.copy_psnr.shape:
            raise ValueError(
                f"{first} was scored on {reference.copy_psnr.size} scenes, {name} on {scores.copy_psnr.size}; was the "
                "code changed between them? use a new folder"
            )
        different = np.abs(scores.copy_psnr - reference.copy_psnr) > SAME_SCENE_DB
        if different.any():
            scene = int(different.argmax())
            raise ValueError(
                f"{first} and {name} were scored on different scenes: in scene {scene} the nearer input has "
                f"{reference.copy_psnr[scene]:.2f} and {scores.copy_psnr[scene]:.2f} dB; was the code changed between "
                "them? use a new folder"
            )
    perceived = [(name, scores.lpips_weights) for name, scores in runs if scores.lpips_weights is not None]
    for name, weights in perceived[1:]:
        first, first_weights = perceived[0]
        if weights != first_weights:
            raise ValueError(
                f"{first} and {name} were scored with different weights for LPIPS; ask for all of them with one --lpips"
            )


def tables(results: Mapping[str, Runs], caption: str) -> str:
    """Markdown: what every variant reaches, then for each table of the paper the differences to the complete model.

    Variants that have no run yet are left out; differences take the seeds that both have.
    """
    found = {name: runs for name, runs in results.items() if runs}
    scores = [scores for runs in found.values() for scores in runs.values()]
    shown = [figure for figure in SHOWN if any(getattr(one, figure[0]) is not None for one in scores)]
    lines = [caption, "", *_reached(found, shown)]
    for title, rows in PAPER.items():
        names = [name for name in rows if name in found]
        if COMPLETE in found and names:
            lines += ["", f"### {title}", "", *_differences(found, {name: rows[name] for name in names}, shown)]
    return "\n".join(lines) + "\n"


# of `SHOWN`, those that at least one run has
Shown = Sequence[tuple[str, str, int]]


def _reached(results: Mapping[str, Runs], shown: Shown) -> list[str]:
    lines = head(["variant", "seeds", "parameters", "minutes", *(title for _, title, _ in shown)])
    for name, runs in results.items():
        seeds = sorted(runs)
        minutes = sum(runs[seed].minutes for seed in seeds) / len(seeds)
        cells = [name, str(len(seeds)), f"{runs[seeds[0]].parameters:,}", f"{minutes:.1f}"]
        for field, _, digits in shown:
            values = stacked(runs, seeds, field)
            cells.append(NONE if values is None else f"{values.mean():.{digits}f}")
        lines.append(row(cells))
    return lines


def _differences(results: Mapping[str, Runs], rows: Mapping[str, str], shown: Shown) -> list[str]:
    titles = [title + (", dB" if field == "psnr" else "") for field, title, _ in shown]
    lines = head(["variant", *titles, "PSNR, relative", "SSIM, relative", "the paper"])
    for name, paper in rows.items():
        seeds = sorted(set(results[name]) & set(results[COMPLETE]))
        if not seeds:
            continue
        cells, relative = [name], {}
        for field, _, digits in shown:
            values, reference = (stacked(results[variant], seeds, field) for variant in (name, COMPLETE))
            if values is None or reference is None:
                cells.append(NONE)
                continue
            difference = paired(values, reference)
            cells.append(cell(difference, digits))
            relative[field] = f"{_signed(100 * difference.mean / float(reference.mean()), 1)} %"
        lines.append(row([*cells, relative["psnr"], relative["ssim"], paper]))
    return lines


def head(titles: Sequence[str]) -> list[str]:
    """First two lines of a Markdown table."""
    return [row(titles), "|" + "---|" * len(titles)]


def row(cells: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def cell(difference: Paired, digits: int) -> str:
    """`-0.31 ± 0.04`, and `(seeds ± 0.10)` where there are several."""
    text = _signed(difference.mean, digits)
    if not math.isnan(difference.scene_error):
        text += f" ± {difference.scene_error:.{digits}f}"
    if not math.isnan(difference.seed_error):
        text += f" (seeds ± {difference.seed_error:.{digits}f})"
    return text


def _signed(value: float, digits: int) -> str:
    """With its sign; what rounds to zero is +0, never -0."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def with_tables(page: str, text: str, marker: str) -> str:
    """The page with `text` between its `<!-- marker: begin -->` and `<!-- marker: end -->`.

    Raises `ValueError` unless the page has each of them once, in order.
    """
    begin, end = f"<!-- {marker}: begin -->", f"<!-- {marker}: end -->"
    counts = page.count(begin), page.count(end)
    if counts != (1, 1) or page.index(begin) > page.index(end):
        raise ValueError(f"the page has {counts[0]} x {begin} and {counts[1]} x {end}, need one of each, in this order")
    before, rest = page.split(begin)
    return f"{before}{begin}\n{text}{end}{rest.split(end)[1]}"
