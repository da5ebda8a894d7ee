"""`python -m gapmes.model.training.curve RUN_FOLDER --out FILE.png`: the learning curve of a run as a picture."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from .log_rows import read_rows
from .recipe import Phase
from .run_folder import LOG, STATE, read_state

F64 = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX, DPI = 900, 760, 100
WIDE, NARROW, TRAINING = "#0b62a4", "#c2541b", "#7a7a7a"
SHADES = ("#f4f4f1", "#e8ebef")  # of phases, in turn


@dataclass(frozen=True, eq=False)
class Curve:
    """A log as columns of n rows each; what a row lacks is nan."""

    steps: F64
    minutes: F64
    psnr: dict[str, F64]  # dB: training, wide, narrow
    copy_psnr: dict[str, F64]  # dB: wide, narrow; the nearer input shown as it is
    depth_error: dict[str, F64]  # of the normalised range: wide, narrow


@dataclass(frozen=True)
class Span:
    """A phase of the recipe on the axis of steps."""

    start: float
    end: float
    label: str


def read_curve(path: Path) -> Curve:
    """The log of a run as columns; raises `ValueError` for a log without rows and as `read_rows` does."""
    rows = read_rows(path)
    if not rows:
        raise ValueError(f"{path} has 0 rows, need at least 1; the first comes with the first validation")

    def column(*keys: str) -> F64:
        return np.array([_number(row, keys, path) for row in rows], np.float64)

    sets = ("wide", "narrow")
    return Curve(
        column("step"),
        column("minutes"),
        {"training": column("train", "psnr")} | {name: column("validation", name, "psnr") for name in sets},
        {name: column("validation", name, "copy_psnr") for name in sets},
        {name: column("validation", name, "depth_error") for name in sets},
    )


def _number(row: dict[str, Any], keys: tuple[str, ...], path: Path) -> float:
    value: Any = row
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    if value is not None and not isinstance(value, int | float):
        raise ValueError(f"{path}, step {row['step']}: {'.'.join(keys)} is {value!r}, need a number")
    return math.nan if value is None else float(value)


def read_phases(path: Path) -> list[Span]:
    """Phases of the recipe that a run's saved state carries; none where there is no such file.

    Raises `ValueError` for a state that is damaged or of another version.
    """
    if not path.is_file():
        return []
    state = read_state(path, mmap=True)
    try:
        recipe = json.loads(state["recipe"])
        spans, start = [], 0.0
        for phase in recipe["phases"]:
            end = start + phase["share"] * recipe["steps"]
            spans.append(Span(start, end, Phase(**phase).label))
            start = end
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} has a recipe of another version, or none: {error!r}") from error
    return spans


def draw_curve(curve: Curve, spans: list[Span], title: str) -> Figure:
    """PSNR above, depth error below, over steps; minutes along the top."""
    figure = Figure(figsize=(WIDTH_PX / DPI, HEIGHT_PX / DPI), dpi=DPI, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [2, 1]})
    last = float(curve.steps.max())
    above.set_xlim(0, last)
    _shade((above, below), spans, last)
    for name, colour in (("narrow", NARROW), ("wide", WIDE)):
        psnr, error, copied = curve.psnr[name], curve.depth_error[name], float(curve.copy_psnr[name][-1])
        marked: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 3.5, "clip_on": False}
        above.plot(curve.steps, psnr, label=f"{name}: {psnr[-1]:.2f} dB at the end", **marked)
        above.axhline(copied, ls="--", color=colour, lw=1.2, label=f"{name}, nearer input shown: {copied:.2f} dB")
        below.plot(curve.steps, error, label=f"{name}: {error[-1]:.3f} at the end", **marked)
    above.plot(curve.steps, curve.psnr["training"], ":", color=TRAINING, lw=1.8, label="training, mean since last row")
    above.set_ylabel("PSNR, dB")
    below.set_ylabel("depth error / range")
    below.set_ylim(bottom=0)
    low, high = above.get_ylim()
    above.set_ylim(low, high + 0.09 * (high - low))  # room for the names of the phases
    below.set_xlabel("step")
    for axes in (above, below):
        axes.grid(color="white", lw=1.0)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    _minutes_axis(above, curve)
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3, fontsize=9, frameon=False)
    below.legend(loc="lower left", ncols=2, fontsize=9, frameon=False)
    figure.suptitle(title, fontsize=12)
    return figure


def _shade(panels: tuple[Axes, ...], spans: list[Span], last: float) -> None:
    for number, span in enumerate(spans):
        if span.start >= last:
            break
        end = min(span.end, last)
        for axes in panels:
            axes.axvspan(span.start, end, color=SHADES[number % len(SHADES)], lw=0, zorder=0)
        middle = (span.start + end) / 2
        panels[0].text(middle, 0.985, span.label, ha="center", va="top", transform=panels[0].get_xaxis_transform())


def _minutes_axis(axes: Axes, curve: Curve) -> None:
    """Round minutes at the steps where they were reached; the log begins at step 0, minute 0."""
    steps, minutes = np.r_[0.0, curve.steps], np.r_[0.0, curve.minutes]
    interval = _round_interval(float(minutes[-1]))
    marks = np.arange(0, minutes[-1] + 1e-9, interval)
    top = axes.secondary_xaxis("top")
    top.set_xticks(np.interp(marks, minutes, steps), [f"{mark:g}" for mark in marks])
    top.set_xlabel("minutes")


def _round_interval(length: float) -> float:
    """The least of 1, 2, 5 times a power of ten that divides a length into at most eight."""
    if length <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(length / 8))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power * 8 >= length * (1 - 1e-12))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m gapmes.model.training.curve", description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN_FOLDER", help=f"folder with {LOG}")
    parser.add_argument("--out", type=Path, required=True, help="picture to write: .png, .svg or .pdf")
    options = parser.parse_args(arguments)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        curve = read_curve(options.run / LOG)
        spans = read_phases(options.run / STATE)
        title = f"Learning curve, {int(curve.steps[-1]):,} steps in {curve.minutes[-1]:.3g} minutes"
        draw_curve(curve, spans, title).savefig(options.out)
    except (ValueError, OSError) as error:
        console.print(f"refused: {error}", markup=False)
        return 1
    console.print(f"written: {options.out}", markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
