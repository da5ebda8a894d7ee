"""The table that the command writes: every case within tolerance, and plain float32 worse where that is the point."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from gapmes.export import measurements
from gapmes.export.cli import app
from gapmes.export.stability import geometry, matching, naive, routing
from gapmes.export.stability import table as writing
from gapmes.export.stability.row import Row
from gapmes.export.stability.splatter import cloud, view
from gapmes.export.stability.table import CASES, all_rows, markdown, stability_table
from gapmes.model.routing import hybrid_weights
from gapmes.service.formats.ply_write import _logit
from gapmes.service.gaussians import normalized_quaternions
from gapmes.service.splat import render_reference


@pytest.fixture(scope="module")
def rows() -> dict[str, Row]:
    return {row.case: row for row in all_rows()}


def test_every_case_is_within_its_tolerance(rows: dict[str, Row]) -> None:
    assert len(rows) == CASES
    assert [row.case for row in rows.values() if not row.passed] == []
    head, *others = markdown(list(rows.values())).splitlines()
    assert {line.count("|") for line in others} == {head.count("|")}


@pytest.mark.parametrize("case", ["E1", "E2", "E6", "E7", "E19", "R1", "R2", "R3", "P6", "P11", "A1", "A3", "I1"])
def test_plain_float32_is_beyond_the_tolerance(rows: dict[str, Row], case: str) -> None:
    assert rows[case].naive is not None
    assert rows[case].naive > rows[case].tolerance


def test_the_plain_renderer_is_right_where_nothing_is_stiff() -> None:
    """It is the same definition: on an ordinary scene it differs by rounding, but for pixels on a cut."""
    scene, camera = cloud(150, 1, (0.02, 0.3), (1.0, 6.0)), view()
    difference = np.abs(naive.picture(scene, camera)[0] - render_reference(scene, camera).rgb)
    assert np.quantile(difference, 0.99) < 1e-5  # measured 2.6e-7


def test_the_command_writes_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = CliRunner().invoke(app, ["--stability", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    body = json.loads((tmp_path / "out" / "stability.json").read_text())
    assert body["passed"]
    assert len(body["rows"]) == CASES
    assert (tmp_path / "out" / "stability.md").read_text().count("\n") == CASES + 2
    failing = Row("E1", "needles", "all", "float64", "opacity", 0.5, 1e-6)
    assert "**5.0e-01**" in markdown([failing])
    monkeypatch.setattr("gapmes.export.stability.table.stability_table", lambda *_: [failing])
    assert CliRunner().invoke(app, ["--stability", str(tmp_path / "out")]).exit_code == measurements.FAILED


def test_a_case_that_finds_nan_fails_and_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = matching.SIZE
    monkeypatch.setattr(matching, "matching_evidence", lambda *_: torch.full((2, 1, size, size), math.nan))
    found = matching.evidence()
    assert not found.passed
    monkeypatch.setattr(writing, "all_rows", lambda: iter([found, Row("E7", "", "", "", "", math.nan, 0.0)]))
    stability_table(tmp_path)
    body = json.loads((tmp_path / "stability.json").read_text())
    assert [(row["passed"], row["worst"]) for row in body["rows"]] == [(False, "not finite")] * 2


def without_short_ones(wxyz: np.ndarray) -> np.ndarray:
    """The identity is a rotation too, but another one."""
    short = np.abs(wxyz).max(axis=1, keepdims=True) < 1e-20
    return normalized_quaternions(np.where(short, np.float32([1, 0, 0, 0]), wxyz))


@pytest.mark.parametrize(
    ("row", "place", "spoilt"),
    [
        (geometry.quaternions, "gapmes.export.stability.geometry.normalized_quaternions", without_short_ones),
        (
            geometry.ply_file,
            "gapmes.service.formats.ply_write._logit",
            lambda opacities: _logit(opacities).astype(np.float16),
        ),
        (
            routing.balance,
            "gapmes.export.stability.routing.hybrid_weights",
            lambda soft, balance: hybrid_weights(soft, 1 - balance),
        ),
    ],
)
def test_a_mistake_that_keeps_lengths_extremes_and_sums_is_found(
    row: Callable[[], Row], place: str, spoilt: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert row().passed
    monkeypatch.setattr(place, spoilt)
    assert not row().passed


def test_progress_is_told_case_by_case(tmp_path: Path) -> None:
    heard = []
    stability_table(tmp_path, heard.append)
    assert [event.done for event in heard if event.seconds is None] == list(range(CASES + 1))
