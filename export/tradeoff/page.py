"""The report as files: JSON with its schema, a page of tables, and the picture of the Pareto fronts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .schema import Report, Row

TITLES = {
    "network": "Network: time of a reconstruction",
    "scene": "Scene: time of a picture of what is kept",
    "picture": "Picture: time at twice the network's size",
}
COLOURS = ("#0b62a4", "#c2541b", "#2e7d4f", "#7a4fa3", "#8a6d1c")


def write(report: Report, out: Path) -> None:
    """report.json, report.schema.json, report.md and pareto.png."""
    (out / "report.json").write_text(report.model_dump_json(indent=1) + "\n")
    (out / "report.schema.json").write_text(json.dumps(Report.model_json_schema(), indent=1) + "\n")
    (out / "report.md").write_text(markdown(report))
    pareto(report).savefig(out / "pareto.png")


def markdown(report: Report) -> str:
    """Tables by group; empty cells are what cannot be measured for a row."""
    machine = report.machine
    lines = [
        f"{machine.cpu}, {machine.threads} threads, {', '.join(machine.flags) or 'no vector flags known'}; "
        f"{', '.join(f'{name} {value}' for name, value in machine.versions.items())}.",
        "",
        f"Scenes: {', '.join(report.scenes)}; times are those of the first. Medians of {report.rows[0].timing.repeats} "
        "runs and more after a warm-up.",
        "",
        "The splatter's own rounding, against brute force in float64: at most "
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
        cells += ["", ""] if bound is None else [f"{bound.bound:.1e}", f"{bound.actual:.1e}"]
        if model is None:
            cells += [""] * 3
        else:
            cells += [f"{model.psnr:.2f} ± {model.psnr_spread:.1f}", f"{model.ssim:.3f}", _number(model.lpips, ".3f")]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def pareto(report: Report) -> Figure:
    """Held-out quality over time of the network; change over time of scenes and pictures, the fronts drawn through."""
    figure = Figure(figsize=(13.5, 4.6), dpi=100, layout="constrained")
    network, scene, picture = figure.subplots(1, 3)
    rows = {group: [row for row in report.rows if row.group == group] for group in TITLES}
    quality = [(row, row.timing.seconds, row.model.psnr) for row in rows["network"] if row.model]
    _scatter(network, quality, "seconds for a reconstruction", "PSNR on held-out views, dB")
    kept = [(row, 1e3 * row.timing.seconds, row.setting.psnr) for row in rows["scene"] if row.setting]
    _scatter(scene, kept, "ms for a picture of what is kept", "PSNR to the whole scene, dB")
    drawn = [(row, 1e3 * row.timing.seconds, row.setting.psnr) for row in rows["picture"] if row.setting]
    _scatter(picture, drawn, "ms for a picture", "PSNR to the most exact value, dB")
    for axes, title in zip((network, scene, picture), TITLES.values(), strict=True):
        axes.set_title(title, fontsize=10, loc="left")
    return figure


def _scatter(axes: Axes, points: Sequence[tuple[Row, float, float]], across: str, up: str) -> None:
    """Points labelled by value and coloured by knob; a line through those that none beats in both. What equals the
    most exact setting lies at the top, beyond the finite values."""
    finite = [value for _, _, value in points if value < 150]
    top = max(finite, default=0.0) + 0.08 * (max(finite, default=1.0) - min(finite, default=0.0) + 1)
    knobs = list(dict.fromkeys(row.knob for row, _, _ in points))
    for knob, colour in zip(knobs, COLOURS * 3, strict=False):
        own = [(row, x, min(y, top)) for row, x, y in points if row.knob == knob]
        axes.plot([x for _, x, _ in own], [y for _, _, y in own], "o", color=colour, label=knob, markersize=6)
        for row, x, y in own:
            weight = "bold" if row.default else "normal"
            axes.annotate(row.value, (x, y), xytext=(5, 3), textcoords="offset points", fontsize=7, weight=weight)
    shown = [(x, min(y, top)) for _, x, y in points]
    front = sorted((x, y) for x, y in shown if not any(a <= x and b >= y and (a, b) != (x, y) for a, b in shown))
    axes.step([x for x, _ in front], [y for _, y in front], where="post", color="#999999", zorder=0, linewidth=1)
    if len(finite) < len(points):
        axes.axhline(top, color="#cccccc", linestyle=":", zorder=0)
        axes.annotate("equal to the bit or to 150 dB", (0.98, top), xycoords=("axes fraction", "data"), fontsize=7,
                      ha="right", va="bottom", color="#777777")  # fmt: skip
    axes.set_xlabel(across, fontsize=9)
    axes.set_ylabel(up, fontsize=9)
    axes.margins(x=0.12, y=0.1)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=7, frameon=False)
