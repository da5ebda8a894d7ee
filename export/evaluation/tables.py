"""Markdown tables of the evaluation report."""

from __future__ import annotations

from collections.abc import Sequence

from .floors import Floor
from .metrics import Figures
from .routing import RoutingStatistics
from .scene_views import HELD_OUT
from .scores import BASELINES, Group, MethodScore, Twice, mean_of

SCENES_SHOWN = 20  # most scenes of a group in a table


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table; | and backslashes in cells are escaped."""
    escaped = [[cell.replace("\\", "\\\\").replace("|", "\\|") for cell in row] for row in (head, *rows)]
    return [f"| {' | '.join(line)} |" for line in (escaped[0], ["---"] * len(head), *escaped[1:])]


def floor_table(floors: Sequence[Floor]) -> list[str]:
    verdict = {True: "pass", False: "**MISSED**", None: "not measured"}
    return table(["floor", "need", "measured", ""], [[f.name, f.need, f.value, verdict[f.passed]] for f in floors])


def group_section(group: Group, lpips: bool) -> list[str]:
    """Heading, means, scenes, twice the size and routing of one group."""
    lines = [f"## {group.title}", "", f"{len(group.scenes)} scenes. Co-visible pixels: {_covisible(group)}.", ""]
    head = ["mean over scenes", *_columns("all", lpips), *_columns("co-visible", lpips)]
    lines += table(head, [[name, *_cells(score, lpips)] for name, score in group.methods().items()])
    lines.append("")
    for model in group.models:
        best, margin = group.margin_of_means(model)
        mean = mean_of(group.margins(model))
        lines.append(
            f"{model}: {mean:+.2f} dB above each scene's best baseline; {margin:+.2f} dB above the {best}, "
            "the best on average."
        )
    lines += ["", *_scene_table(group), "", *_warnings(group), *_twice_table(group), *_routing_table(group)]
    lines += _held_out(group)
    for scene, reason in group.left_out.items():
        lines += [f"Left out: {scene}: {reason}", ""]
    return lines


def _warnings(group: Group) -> list[str]:
    """What a reconstruction would tell of the photographs' scenes; of generated ones it is in report.json alone."""
    lines = [f"- {scene}: {line.removeprefix('warning: ')}" for scene, line in group.told]
    return ["Warnings, as `reconstruct` gives them:", "", *lines, ""] if lines else []


def _held_out(group: Group) -> list[str]:
    """Inputs and targets of the scenes that suggest none."""
    lines = []
    for scene in group.scenes:
        if (said := scene.photographs) is not None and said.by == HELD_OUT:
            lines.append(f"- {scene.scene}: inputs {', '.join(said.inputs)}; targets {', '.join(said.targets)}")
    return ["Held out, as these captures suggest no views:", "", *lines, ""] if lines else []


def precision_table(groups: Sequence[Group], lpips: bool) -> list[str]:
    """Differences of every further model to the first, on the same scenes."""
    rows = []
    for group in groups:
        first, *others = group.models
        methods = group.methods()
        for other in others:
            pairs = [(methods[other].all, methods[first].all), (methods[other].covisible, methods[first].covisible)]
            rows.append([group.title, f"{other} - {first}", *[c for a, b in pairs for c in _differences(a, b, lpips)]])
    return table(["group", "models", *_columns("all", lpips), *_columns("co-visible", lpips)], rows)


def _covisible(group: Group) -> str:
    share = mean_of([scene.covisible_share for scene in group.scenes])
    return f"{share:.1%} of the targets, by the {group.covisible_from}, the same for every method"


def _columns(pixels: str, lpips: bool) -> list[str]:
    return [f"PSNR {pixels}", f"SSIM {pixels}", *([f"LPIPS {pixels}"] if lpips else [])]


def _cells(score: MethodScore, lpips: bool) -> list[str]:
    return [cell for figures in (score.all, score.covisible) for cell in _figures(figures, lpips)]


def _figures(figures: Figures, lpips: bool) -> list[str]:
    cells = [_text(figures.psnr, ".2f"), _text(figures.ssim, ".3f")]
    return [*cells, _text(figures.lpips, ".3f")] if lpips else cells


def _differences(a: Figures, b: Figures, lpips: bool) -> list[str]:
    names = {"psnr": "+.3f", "ssim": "+.4f", "lpips": "+.4f"} if lpips else {"psnr": "+.3f", "ssim": "+.4f"}
    pairs = [(getattr(a, name), getattr(b, name), form) for name, form in names.items()]
    return [_text(None if x is None or y is None else x - y, form) for x, y, form in pairs]


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"


def _scene_table(group: Group) -> list[str]:
    first = group.models[0]
    scenes = list(group.scenes)
    lines = []
    if len(scenes) > SCENES_SHOWN:
        scenes = sorted(scenes, key=lambda scene: scene.margin(first))[:SCENES_SHOWN]
        lines = [
            f"The {SCENES_SHOWN} scenes with the smallest margin of {len(group.scenes)}; all are in report.json.",
            "",
        ]
    head = [
        "PSNR, all pixels",
        *group.models,
        *BASELINES,
        "margin",
        "co-visible",
        "holes",
        "holes co-visible",
        "seconds",
    ]
    rows = []
    for scene in scenes:
        ours = scene.models[first]
        rows.append(
            [
                scene.scene,
                *[_text(scene.models[m].score.all.psnr, ".2f") for m in group.models],
                *[_text(scene.baselines[b].all.psnr, ".2f") for b in BASELINES],
                f"{scene.margin(first):+.2f}",
                f"{scene.covisible_share:.1%}",
                f"{ours.holes:.3%}",
                _text(ours.holes_covisible, ".3%"),
                f"{ours.seconds:.2f}",
            ]
        )
    return [*lines, *table(head, rows)]


def _twice_table(group: Group) -> list[str]:
    """Means, then scenes, at most `SCENES_SHOWN`: those where the first model changes most."""
    models = group.models
    found = [(s.scene, [(m, t) for m in models if (t := s.models[m].twice) is not None]) for s in group.scenes]
    found = [(scene, rows) for scene, rows in found if rows]
    if not found:
        return []
    changes = ["change in dB", "1x enlarged", "detail alone"]
    head = [f"at {group.size.twice} px", "model", "PSNR", *changes, "holes", "truth"]
    means = [["mean", m, *_twice_cells([t for _, rows in found for n, t in rows if n == m]), ""] for m in models]
    lines = []
    if len(found) > SCENES_SHOWN:
        lines = [f"The {SCENES_SHOWN} scenes that change most of {len(found)}; all are in report.json.", ""]
        found = sorted(found, key=lambda entry: -abs(entry[1][0][1].change))[:SCENES_SHOWN]
    rows = [
        [
            scene,
            name,
            *_twice_cells([t]),
            ""
            if t.side_px >= min(group.size.twice)
            else f"photograph has {t.side_px} px on its shorter side, enlarged",
        ]
        for scene, entries in found
        for name, t in entries
    ]
    return [*lines, *table(head, [*means, *rows]), ""]


def _twice_cells(values: Sequence[Twice]) -> list[str]:
    psnr, change = mean_of([t.psnr for t in values]), mean_of([t.change for t in values])
    enlarged, detail = mean_of([t.enlarged for t in values]), mean_of([t.detail for t in values])
    holes = mean_of([t.holes for t in values])
    return [f"{psnr:.2f}", f"{change:+.2f}", f"{enlarged:+.2f}", f"{detail:+.2f}", f"{holes:.3%}"]


def _routing_table(group: Group) -> list[str]:
    lines = []
    for model, statistics in group.routing.items():
        if statistics is not None:
            lines += [f"Routing of {model}, {statistics.patches} patches:", "", *_routing_rows(statistics), ""]
    return lines


def _routing_rows(statistics: RoutingStatistics) -> list[str]:
    rows = []
    if statistics.expert_share:
        shares = ", ".join(f"{share:.1%}" for share in statistics.expert_share)
        rows.append(["share of choices per expert", shares])
    if statistics.task_mean:
        names = statistics.task_mean
        weights = ", ".join(f"{n} {statistics.task_mean[n]:.3f} ± {statistics.task_deviation[n]:.3f}" for n in names)
        rows.append(["task weight, mean ± deviation over patches", weights])
    lambdas = statistics.lambdas
    known = (
        "unknown: no checkpoint of these weights"
        if lambdas is None
        else ", ".join(f"{n} {v:.3f}" for n, v in lambdas.items())
    )
    rows.append(["lambda (Eq. 11)", known])
    return table(["routing", "value"], rows)
