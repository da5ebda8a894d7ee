"""The report as files: JSON with its schema, a page of tables, and the picture of the Pareto fronts."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter

from gapmes.service.process.disk import replacing

from .errors import EQUAL_DB
from .knobs import BANDS
from .labels import spread
from .schema import Report, Row

TITLES = {
    "network": "Network: time of a reconstruction",
    "scene": "Scene: time of a picture of what is kept",
    "picture": "Picture: time at twice the network's size",
}
COLOURS = ("#0b62a4", "#c2541b", "#2e7d4f", "#7a4fa3", "#8a6d1c", "#b3267a", "#4f6d7a")

WRITTEN = ("report.json", "report.schema.json", "report.md", "pareto.png")


def write(report: Report, out: Path) -> None:
    """Write the files of `WRITTEN` into `out`."""
    picture = io.BytesIO()
    pareto(report).savefig(picture, format="png")
    made = (
        (report.model_dump_json(indent=1) + "\n").encode(),
        (json.dumps(Report.model_json_schema(), indent=1) + "\n").encode(),
        markdown(report).encode(),
        picture.getvalue(),
    )
    for name, data in zip(WRITTEN, made, strict=True):
        with replacing(out / name) as part:
            part.write_bytes(data)


def markdown(report: Report) -> str:
    """A table for each group; a cell is empty where a row has no such figure."""
    machine = report.machine
    lines = [
        f"{machine.cpu}, {machine.threads} threads, {', '.join(machine.flags) or 'no vector flags known'}; "
        f"{', '.join(f'{name} {value}' for name, value in machine.versions.items())}.",
        "",
        f"Scenes: {', '.join(report.scenes)}. Times are those of the first: medians of at least "
        f"{report.rows[0].timing.repeats} runs after a warm-up.",
        "",
        "The splatter's own rounding, against brute force in float64, is at most "
        f"{report.splatter_rounding.largest:.1e} of a colour.",
        "",
    ]
    for group, title in TITLES.items():
        lines += [f"## {title}", "", *_table([row for row in report.rows if row.group == group]), ""]
    return "\n".join(lines)


def _table(rows: Sequence[Row]) -> list[str]:
    names = [
        "knob", "value", "set by", "ms", "MB", "peak MB", "rounding: p99", "largest", "change: p99", "largest", "PSNR",
        "bound", "found", "held out: PSNR", "SSIM", "LPIPS",
    ]  # fmt: skip
    lines = ["| " + " | ".join(names) + " |", "|---" * len(names) + "|"]
    for row in rows:
        rounding, setting, model, bound = row.rounding, row.setting, row.model, row.bound
        cells = [row.knob, f"**{row.value}**" if row.default else row.value, row.how]
        cells += [f"{1e3 * row.timing.seconds:.1f}", _number(row.megabytes, ".1f"), _number(row.peak_mb, ".0f")]
        cells += ["", ""] if rounding is None else [f"{rounding.p99:.1e}", f"{rounding.largest:.1e}"]
        cells += (
            [""] * 3 if setting is None else [f"{setting.p99:.1e}", f"{setting.largest:.1e}", f"{setting.psnr:.1f}"]
        )
        cells += (
            ["", ""]
            if bound is None
            else [f"{bound.bound:.1e}", f"{bound.actual:.1e}{'' if bound.held else ' **beyond**'}"]
        )
        if model is None:
            cells += [""] * 3
        else:
            cells += [f"{model.psnr:.2f} ± {model.psnr_spread:.1f}", f"{model.ssim:.3f}", _number(model.lpips, ".3f")]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def pareto(report: Report) -> Figure:
    """Held-out quality over time of the network and change over time of scenes, each with its Pareto front. Pictures
    have a line per knob, since each knob has an exact value of its own. The random harmonics are left out."""
    figure = Figure(figsize=(13.5, 4.8), dpi=100, layout="constrained")
    panels = figure.subplots(1, 3)
    rows = {group: [row for row in report.rows if row.group == group] for group in TITLES}
    quality = [(row, row.timing.seconds, row.model.psnr) for row in rows["network"] if row.model]
    _scatter(panels[0], quality, "seconds for a reconstruction", "PSNR on held-out views, dB")
    _front(panels[0], [(x, y) for _, x, y in quality])
    kept = [(row, 1e3 * row.timing.seconds, row.setting.psnr) for row in rows["scene"] if row.setting]
    top = _scatter(panels[1], kept, "ms for a picture of what is kept", "PSNR to the whole scene, dB")
    _front(panels[1], [(x, min(y, top)) for _, x, y in kept])
    drawn = [(row, 1e3 * row.timing.seconds, row.setting.psnr) for row in rows["picture"] if row.setting]
    drawn = [point for point in drawn if point[0].knob != BANDS]
    _scatter(panels[2], drawn, "ms for a picture", "PSNR to the knob's most exact value, dB", joined=True)
    for axes, title in zip(panels, TITLES.values(), strict=True):
        axes.set_title(title, fontsize=10, loc="left")
    spread(figure)
    return figure


def _scatter(
    axes: Axes, points: Sequence[tuple[Row, float, float]], across: str, up: str, *, joined: bool = False
) -> float:
    """Plot points labelled by value and coloured by knob, on a logarithmic time axis; a default that knobs share is
    labelled once. Points equal to the most exact setting have no finite PSNR and are plotted on a line of their own,
    whose height is returned."""
    finite = [value for _, _, value in points if value < EQUAL_DB]
    top = max(finite, default=0.0) + 0.1 * (max(finite, default=1.0) - min(finite, default=0.0) + 1)
    knobs = list(dict.fromkeys(row.knob for row, _, _ in points))
    shared = Counter((x, y) for row, x, y in points if row.default)
    axes.set_xscale("log")
    for number, knob in enumerate(knobs):
        own = [(row, x, min(y, top)) for row, x, y in points if row.knob == knob]
        style = "o-" if joined else "o"
        colour = COLOURS[number]
        axes.plot([x for _, x, _ in own], [y for _, _, y in own], style, color=colour, label=knob, markersize=5)
        for row, x, y in own:
            if row.default and shared[x, y] > 1:
                continue
            weight = "bold" if row.default else "normal"
            axes.annotate(
                row.value, (x, y), (0, 0), textcoords="offset points", fontsize=7, color=colour, weight=weight
            )
    for (x, y), count in shared.items():
        if count > 1:
            axes.annotate("default", (x, y), (0, 0), textcoords="offset points", fontsize=7, weight="bold")
    if len(finite) < len(points):
        axes.axhline(top, color="#cccccc", linestyle=":", zorder=0)
        axes.annotate("equal", (0.01, top), xycoords=("axes fraction", "data"), fontsize=7, ha="left", va="bottom",
                      color="#777777")  # fmt: skip
    axes.set_xlabel(across, fontsize=9)
    axes.set_ylabel(up, fontsize=9)
    axes.margins(x=0.15, y=0.1)
    axes.tick_params(labelsize=8)
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(ScalarFormatter())
    axes.tick_params(axis="x", which="minor", labelsize=6)
    axes.legend(fontsize=7, frameon=False)
    return top


def _front(axes: Axes, points: Sequence[tuple[float, float]]) -> None:
    """Draw the Pareto front: a line through the points that no other point beats in both values."""
    front = sorted(p for p in points if not any(a <= p[0] and b >= p[1] and (a, b) != p for a, b in points))
    axes.step([x for x, _ in front], [y for _, y in front], where="post", color="#999999", zorder=0, linewidth=1)
