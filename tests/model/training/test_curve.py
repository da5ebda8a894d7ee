"""The learning curve: reading a log, phases and minutes, and the plot of them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from gapmes.model.training import curve
from gapmes.model.training.recipe import Recipe

RECIPE = Recipe()


def row(step: int, minutes: float, wide: float, narrow: float) -> dict[str, object]:
    def figures(psnr: float, copied: float) -> dict[str, object]:
        return {"psnr": psnr, "copy_psnr": copied, "depth_error": 1 / psnr}

    return {
        "step": step,
        "minutes": minutes,
        "train": {"psnr": wide - 1},
        "validation": {"wide": figures(wide, 17.0), "narrow": figures(narrow, 18.5)},
    }


# the second half takes three times as long, as larger pictures do
ROWS = [row(100 * k, k if k <= 5 else 5 + 3 * (k - 5), 20 + k / 5, 26 + k / 5) for k in range(1, 11)]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(r) + "\n" for r in ROWS) + '{"step": 11')
    state = {"recipe": json.dumps({**asdict(RECIPE), "steps": 1000}), "model": {"w": torch.zeros(3)}}
    torch.save(state, tmp_path / "state.pt")
    return tmp_path


def test_columns_are_the_numbers_of_the_log(run: Path) -> None:
    """The unfinished last line is not a row yet."""
    found = curve.read_curve(run / "log.jsonl")
    assert found.steps.tolist() == [r["step"] for r in ROWS]
    assert found.psnr["wide"].tolist() == [r["validation"]["wide"]["psnr"] for r in ROWS]
    assert found.psnr["training"].tolist() == [r["train"]["psnr"] for r in ROWS]
    assert found.copy_psnr["narrow"].tolist() == [18.5] * 10
    assert found.depth_error["narrow"].tolist() == [r["validation"]["narrow"]["depth_error"] for r in ROWS]


def test_what_a_row_lacks_is_a_gap(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text('{"step": 1, "minutes": 0.5, "train": {}}\n')
    found = curve.read_curve(tmp_path / "log.jsonl")
    assert np.isnan(found.psnr["training"]).all()
    assert np.isnan(found.psnr["wide"]).all()


def test_phases_follow_the_recipe_and_its_steps(run: Path) -> None:
    spans = curve.read_phases(run / "state.pt")
    recipe = Recipe(steps=1000)
    for span, phase in zip(spans, recipe.phases, strict=True):
        assert span.label == phase.label
        for step in (int(span.start) + 1, int(span.end) - 1):
            assert recipe.phase(step) is phase
    assert curve.read_phases(run / "none.pt") == []


def test_a_recipe_of_another_version_is_said(run: Path) -> None:
    recipe = {"steps": 10, "phases": [{"share": 1.0, "size": 64}]}
    torch.save({"recipe": json.dumps(recipe)}, run / "state.pt")
    with pytest.raises(ValueError, match="of another version"):
        curve.read_phases(run / "state.pt")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut short", b"text"])
def test_a_damaged_state_is_refused_by_name(content: bytes, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "state.pt").write_bytes(content)
    assert curve.main([str(run), "--out", str(run / "curve.png")]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {run / 'state.pt'} cannot be read as the state of a run")
    assert told.count("\n") == 1
    assert not (run / "curve.png").exists()


@pytest.mark.parametrize("state", [{}, {"recipe": "{}"}, {"recipe": "x"}, {"recipe": None}])
def test_a_state_without_a_recipe_is_refused(state: dict[str, object], run: Path) -> None:
    torch.save(state, run / "state.pt")
    with pytest.raises(ValueError, match=r"state\.pt has a recipe of another version, or none"):
        curve.read_phases(run / "state.pt")


def test_minutes_stand_at_the_steps_where_they_were_reached(run: Path) -> None:
    figure = drawn(run)
    top = figure.axes[0].child_axes[0]
    at = {label.get_text(): position for label, position in zip(top.get_xticklabels(), top.get_xticks(), strict=True)}
    assert at["0"] == 0
    # 5 minutes at step 500, then 3 minutes for each 100 steps
    assert at["5"] == pytest.approx(500)
    assert at["20"] == pytest.approx(1000)
    assert figure.axes[0].get_xlim() == (0, 1000)


def drawn(run: Path) -> Figure:
    return curve.draw_curve(curve.read_curve(run / "log.jsonl"), curve.read_phases(run / "state.pt"), "title")


@pytest.mark.parametrize("length", [1e-3, 0.9, 7.99, 8.0, 8.01, 59.5, 160.0, 161.0, 12345.6])
def test_round_intervals_are_round_and_the_least_that_fits(length: float) -> None:
    interval = curve._round_interval(length)
    candidates = [factor * 10.0**power for power in range(-6, 7) for factor in (1, 2, 5)]
    assert interval == pytest.approx(min(c for c in candidates if c * 8 >= length * (1 - 1e-9)))


def test_the_picture_shows_the_curves_over_shaded_phases(run: Path) -> None:
    out = run / "curve.png"
    assert curve.main([str(run), "--out", str(out)]) == 0
    with Image.open(out) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape == (curve.HEIGHT_PX, curve.WIDTH_PX, 3)
    for colour in (curve.WIDE, curve.NARROW, *curve.SHADES):
        wanted = np.round(np.array(to_rgb(colour)) * 255)
        assert (np.abs(pixels - wanted).max(axis=2) <= 1).sum() > 100, colour


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 rows"),
        ('{"step": 1, "minutes": 1}\n{"step": 2}\n', "line 2"),
        ("[1]\n", "line 1"),
        ("no\n", "line 1"),
        ('{"step": Infinity, "minutes": 1}\n', "line 1"),
        ('{"step": 1, "minutes": NaN}\n', "line 1"),
        (f'{{"step": 1{"0" * 400}, "minutes": 1}}\n', "line 1"),
        ('{"step": 7, "minutes": 1, "train": {"psnr": [20.5]}}\n', "step 7: train.psnr is [20.5], need a number"),
        ('{"step": 7, "minutes": 1, "train": {"psnr": "20"}}\n', "step 7: train.psnr is '20', need a number"),
    ],
)
def test_a_damaged_log_is_refused_by_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    (tmp_path / "log.jsonl").write_text(text)
    out = tmp_path / "curve.png"
    assert curve.main([str(tmp_path), "--out", str(out)]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()
