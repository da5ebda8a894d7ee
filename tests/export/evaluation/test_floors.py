"""Figures just above a floor pass it and figures just below miss it; the tables say what each floor means."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import groupby

import pytest

from gapmes.export.evaluation.floors import Floor, floors
from gapmes.export.evaluation.metrics import Figures
from gapmes.export.evaluation.report import Report
from gapmes.export.evaluation.routing import RoutingStatistics
from gapmes.export.evaluation.scores import (
    NEAREST,
    PLANE,
    SWEEP,
    TRUE_DEPTH,
    TUNED_SWEEP,
    Group,
    MethodScore,
    ModelScore,
    SceneScore,
    Twice,
)
from gapmes.export.evaluation.tables import floor_table, group_section, precision_table
from gapmes.export.size import Size

SEPARATOR = re.compile(r"(?<!\\)(?:\\\\)*\|")  # of cells: after no backslash, or an even number of them


def score(psnr: float) -> MethodScore:
    return MethodScore(Figures(psnr, 0.8, None), Figures(psnr + 1, 0.9, None))


def scene(name: str, ours: float, best: float, twice: Twice | None = None, open_share: float = 0.0) -> SceneScore:
    baselines = {NEAREST: score(best - 5), PLANE: score(best - 1), SWEEP: score(best - 0.3), TUNED_SWEEP: score(best)}
    baselines[TRUE_DEPTH] = score(99.0)
    return SceneScore(name, 0.9, baselines, {"ours": ModelScore(score(ours), open_share, open_share, 0.1, twice)})


def group(kind: str, inputs: int, margins: tuple[float, ...], least_expert: float = 0.1, side: int = 128) -> Group:
    share = [1 - 5 * least_expert, *[least_expert] * 5]
    routing = {"ours": RoutingStatistics(10, share, {"mean": 0.25}, {"mean": 0.1}, {"experts": 0.4})}
    scenes = [
        scene(f"s{i}", 20.0 + i + m, 20.0 + i, Twice(19.0, -1.0, -0.5, -0.4, 0.001, 300)) for i, m in enumerate(margins)
    ]
    return Group(kind, inputs, Size.square(side), "true depth", scenes, routing)


GOOD = [
    group("generated", 2, (2.6, 2.5)),
    group("photographs", 2, (5.0, 0.1)),
    group("photographs", 3, (1.4, 1.7)),
]


def verdicts(groups: list[Group]) -> dict[str, bool | None]:
    return {floor.name: floor.passed for floor in floors(groups)}


def test_good_figures_pass_every_floor() -> None:
    result = verdicts(GOOD)
    assert len(result) == 2 * 4 + 2 + 1 + 3
    assert set(result.values()) == {True}


def with_scene(index: int, **changes: object) -> list[Group]:
    """GOOD with the last scene of one group changed."""
    groups = list(GOOD)
    scenes = list(groups[index].scenes)
    ours = scenes[-1].models["ours"]
    scenes[-1] = replace(scenes[-1], models={"ours": replace(ours, **changes)})
    groups[index] = replace(groups[index], scenes=scenes)
    return groups


@pytest.mark.parametrize(
    ("groups", "missed"),
    [
        ([group("generated", 2, (2.4, 2.5)), *GOOD[1:]], "generated, 2 views, 128 px: mean"),
        ([GOOD[0], group("photographs", 2, (4.5, 0.1)), GOOD[2]], "photographs, 2 views, 128 px: mean"),
        ([GOOD[0], group("photographs", 2, (6.0, -0.1)), GOOD[2]], "photographs, 2 views, 128 px: above"),
        ([*GOOD[:2], group("photographs", 3, (1.4, 1.5))], "photographs, 3 views, 128 px: mean"),
        (with_scene(1, twice=Twice(18.0, -1.6, -0.5, -0.4, 0.0, 300)), "twice the size: PSNR"),
        (with_scene(1, twice=Twice(22.0, 1.6, -0.5, -0.4, 0.0, 300)), "twice the size: PSNR"),
        (with_scene(2, twice=Twice(18.0, -1.0, -0.5, -0.4, 0.011, 300)), "twice the size: holes"),
        (with_scene(0, holes_covisible=1e-6), "holes in co-visible"),
        ([GOOD[0], GOOD[1], group("photographs", 3, (1.4, 1.7), least_expert=0.029)], "least used expert"),
        ([*GOOD, group("photographs", 2, (2.3, 2.3), side=256)], "photographs, 2 views, 256 px: mean"),
        ([*GOOD, group("generated", 2, (2.3, 2.3), side=64)], "generated, 2 views, 64 px: mean"),
    ],
)
def test_each_floor_is_missed_just_below_it_and_no_other(groups: list[Group], missed: str) -> None:
    failed = [name for name, passed in verdicts(groups).items() if passed is False]
    assert len(failed) == 1
    assert failed[0].startswith(missed)


def test_a_model_below_the_simple_baselines_misses_both_kinds_of_floor() -> None:
    low = group("photographs", 2, (-0.4, 0.4))
    failed = [name for name, passed in verdicts([GOOD[0], low, GOOD[2]]).items() if passed is False]
    which = [(what, kind) for what in ("mean above each scene's best", "above the best") for kind in ("simple ", "")]
    expected = [f"{low.title}: {what} {kind}baseline" for what, kind in which]
    assert {name.removesuffix(" on every scene") for name in failed} == set(expected)


def test_what_was_not_measured_is_neither_passed_nor_missed() -> None:
    result = verdicts([GOOD[0]])
    assert [name for name, passed in result.items() if passed is None] == [
        "photographs, 2 views: mean above each scene's best baseline",
        "photographs, 3 views: mean above each scene's best baseline",
    ]
    without_twice = replace(GOOD[0], scenes=[scene("a", 30, 20)], routing={"ours": None})
    assert verdicts([without_twice])["twice the size: holes on every scene"] is None


def test_the_best_baseline_is_that_of_each_scene_and_true_depth_is_none() -> None:
    one, other = scene("a", 22, 20), scene("b", 25, 20)
    other.baselines[PLANE] = score(24)
    both = Group("photographs", 2, Size.square(64), "true depth", [one, other], {"ours": None})
    assert [s.best_baseline for s in both.scenes] == [TUNED_SWEEP, PLANE]
    assert both.margins("ours") == [2, 1]
    assert both.margin_of_means("ours") == (PLANE, pytest.approx(23.5 - 21.5))


def test_the_tables_show_every_method_scene_and_verdict() -> None:
    text = "\n".join(group_section(GOOD[1], lpips=False))
    for word in (NEAREST, PLANE, SWEEP, TUNED_SWEEP, TRUE_DEPTH, "ours", "s0", "s1", "+2.55 dB", "at 256 px", "0.400"):
        assert word in text
    assert "photograph has" not in text  # 300 px are enough for 256
    assert "LPIPS" not in text
    assert "LPIPS all" in "\n".join(group_section(GOOD[1], lpips=True))
    lines = floor_table([Floor("a|b", "> 1", "2", True), Floor("c", "> 1", "0", False)])
    assert lines[2] == "| a\\|b | > 1 | 2 | pass |"
    assert "MISSED" in lines[3]
    pair = scene("a", 22.0, 20)
    pair.models["int8"] = replace(pair.models["ours"], score=score(21.5))
    rows = precision_table([Group("photographs", 2, Size.square(64), "true depth", [pair], {})], lpips=False)
    assert "int8 - ours" in rows[-1]
    assert "-0.500" in rows[-1]


def test_names_of_files_do_not_break_the_tables() -> None:
    """Line ends would end a row, and separators a cell; the head with the models is included."""
    odd = scene("a|b\nc\\|d", 22.0, 20)
    odd.models["net|1\r# 2"] = odd.models.pop("ours")
    unusual = Group("photographs", 2, Size.square(64), "true depth", [odd], {"net|1\r# 2": None}, {"e\nf": "g\nh"})
    lines = Report([], [unusual], None).markdown().splitlines()
    assert "Left out: e f: g h" in lines
    assert any(line.startswith("| a\\|b c\\\\\\|d | 22.00 |") for line in lines)
    assert any(line.startswith("| net\\|1\\r# 2 | 22.00 | 0.800 |") for line in lines)
    tables = [list(rows) for is_row, rows in groupby(lines, lambda line: line.startswith("|")) if is_row]
    assert len(tables) == 4  # models, floors, means, scenes
    for rows in tables:
        assert len({len(SEPARATOR.findall(row)) for row in rows}) == 1


@pytest.mark.parametrize(
    ("groups", "missed"),
    [
        (with_scene(1, twice=Twice(18.0, -1.49, -0.5, -0.4, 0.0099, 300)), None),
        (with_scene(1, twice=Twice(18.0, -1.5, -0.5, -0.4, 0.0, 300)), "twice the size: PSNR"),
        (with_scene(1, twice=Twice(18.0, -1.0, -0.5, -0.4, 0.01, 300)), "twice the size: holes"),
        ([GOOD[0], GOOD[1], group("photographs", 3, (1.4, 1.7), least_expert=0.03)], None),
    ],
)
def test_floors_are_where_they_are_said_to_be(groups: list[Group], missed: str | None) -> None:
    failed = [name for name, passed in verdicts(groups).items() if passed is False]
    assert len(failed) == (missed is not None)
    assert all(name.startswith(missed or "") for name in failed)
