"""Bounds in the report of error against run time: of all scenes, each of which has to keep its own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gapmes.export.tradeoff import run
from gapmes.export.tradeoff.page import _table
from gapmes.export.tradeoff.schema import Bound, Row, Timing


def row(bound: Bound) -> Row:
    timing = Timing(seconds=1.0, stages={}, repeats=1)
    return Row(
        group="scene", knob="opacity", value="0.5", how="", default=False, timing=timing, peak_mb=None, megabytes=None,
        rounding=None, setting=None, model=None, bound=bound,
    )  # fmt: skip


def test_the_largest_of_each_is_told_also_where_they_are_of_two_scenes() -> None:
    found = Bound.of([1.09, 1.06, 1.07], [0.62, 0.72, 0.77])
    assert (found.bound, found.actual, found.held) == (1.09, 0.77, True)
    assert "| 1.1e+00 | 7.7e-01 |" in _table([row(found)])[-1]


def test_one_scene_beyond_its_own_bound_is_told_though_another_s_is_larger() -> None:
    found = Bound.of([0.2, 0.01], [0.1, 0.011])
    assert (found.bound, found.actual, found.held) == (0.2, 0.1, False)
    assert "| 1.0e-01 **beyond** |" in _table([row(found)])[-1]
    assert Bound.of([0.01], [0.01 + 9e-7]).held  # pictures are float32


def test_the_change_is_looked_for_in_every_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = {"width": 4, "height": 4, "fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 2.0, "c2w": np.eye(4).tolist()}
    documents = [{"view_cameras": [camera] * views} for views in (1, 2, 3)]
    sets: Any = SimpleNamespace(documents=documents, gaussians=[0.125, 0.5, 0.25])
    measure: Any = SimpleNamespace(whole=SimpleNamespace(gaussians=[0.0, 0.0, 0.0]), near=lambda index: 0.1)
    monkeypatch.setattr(run, "drawn", lambda level, views, near: [np.full((3, 4, 4), level, np.float32) for _ in views])
    assert run._Measure._actual(measure, sets) == [0.125, 0.5, 0.25]
