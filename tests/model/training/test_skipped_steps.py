"""Steps whose loss or gradient is not finite: no weight changes, and the log has the means of the other steps."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from test_training_loop import SMALL, one_thread
from torch import Tensor, nn

from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import loop, run_folder
from gapmes.model.training.recipe import Phase, Recipe
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.training.workers import Worker

THREE = replace(SMALL, steps=3, phases=(Phase(1.0, (32,), 1, (2,), (0.1, 0.4)),))
ALONE = Worker()
Spoiled = Callable[[Tensor, int], Tensor]


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    one_thread()


def trained(folder: Path, spoil: Spoiled, patch: pytest.MonkeyPatch, worker: Worker = ALONE) -> list[dict[str, Tensor]]:
    """The weights before each step and after the last of a run whose losses go through `spoil`."""
    real, weights = loop.training_loss, []

    def spoiled(model: GaPMeS, batch: object, recipe: Recipe, step: int) -> tuple[Tensor, dict[str, float]]:
        weights.append({name: p.detach().clone() for name, p in model.named_parameters() if p.requires_grad})
        loss, parts = real(model, batch, recipe, step)
        found = spoil(loss, step)
        return found, parts if bool(torch.isfinite(found)) else dict.fromkeys(parts, math.nan)

    patch.setattr(loop, "training_loss", spoiled)
    loop.train(
        TrainingRun(preset("tiny"), THREE, folder, validate_every=3, validation_scenes=1, save_seconds=1e9),
        worker=worker,
    )
    state = run_folder.read_state(folder / run_folder.STATE)
    weights.append(state["model"])
    assert all(bool(torch.isfinite(value).all()) for value in state["average"].values())
    return weights


def same(a: dict[str, Tensor], b: dict[str, Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(value, b[name]) for name, value in a.items())


def row_of(folder: Path) -> dict[str, float]:
    """The figures of the training in the only row, which has no NaN: JSON does not know it."""
    (line,) = (folder / run_folder.LOG).read_text().splitlines()
    return json.loads(line, parse_constant=lambda name: pytest.fail(name))["train"]


@pytest.mark.parametrize("added", [math.nan, math.inf])
def test_a_loss_that_is_not_finite_changes_nothing_even_if_its_gradient_is_finite(
    added: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, third, last = trained(tmp_path, lambda loss, step: loss + (added if step == 1 else 0.0), monkeypatch)
    assert not same(first, second)
    assert same(second, third)
    assert not same(third, last)


def test_means_are_those_of_the_steps_that_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two equal steps and one whose loss is NaN: the mean is that of either."""
    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", lambda given, _: 4 + 0 * given[0].grad.sum())
    monkeypatch.setattr(torch.optim.AdamW, "step", lambda *_: None)
    real = loop.training_loss

    def constant(model: GaPMeS, batch: object, recipe: Recipe, step: int) -> tuple[Tensor, dict[str, float]]:
        loss, _ = real(model, batch, recipe, step)
        bad = math.nan if step == 1 else 0.0
        return loss + bad, {"mse": 0.01 + bad, "depth": 0.5 + bad}

    monkeypatch.setattr(loop, "training_loss", constant)
    loop.train(TrainingRun(preset("tiny"), THREE, tmp_path, validate_every=3, validation_scenes=1, save_seconds=1e9))
    assert row_of(tmp_path) == {"depth": 0.5, "gradient_norm": 4.0, "skipped": 0.33333, "psnr": 20.0}


def test_a_row_of_skipped_steps_alone_has_no_means_and_the_terminal_tells_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, loop.__name__):
        first, *others = trained(tmp_path, lambda loss, _: loss * math.nan, monkeypatch)
    assert "skipped 100.0% of the steps" in caplog.text
    assert all(same(first, other) for other in others)
    assert row_of(tmp_path) == {"skipped": 1.0}


class Noting(Worker):
    """Notes whether the gradients that go to the other processes are finite."""

    finite: list[bool] = []  # noqa: RUF012 - of the class, which is frozen

    def average_gradients(self, parameters: list[nn.Parameter]) -> None:
        given = [p.grad for p in parameters if p.grad is not None]
        self.finite.append(all(bool(torch.isfinite(grad).all()) for grad in given))


def test_a_loss_that_is_not_finite_in_one_process_is_skipped_by_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They decide by the mean gradient, which is not finite either."""
    monkeypatch.setattr(Noting, "finite", [])
    trained(tmp_path, lambda loss, step: loss + (math.nan if step == 1 else 0.0), monkeypatch, Noting())
    assert Noting.finite == [True, False, True]


def test_a_run_on_another_kind_of_device_is_not_continued(tmp_path: Path) -> None:
    """A graphics card draws other noise for the gates from the same seed."""
    one = replace(THREE, steps=1)
    loop.train(TrainingRun(preset("tiny"), one, tmp_path, validate_every=9, validation_scenes=1))
    path = tmp_path / run_folder.STATE
    torch.save(run_folder.read_state(path) | {"device": "cuda"}, path)
    with pytest.raises(run_folder.Refused, match="another device: cuda, asked for cpu; go on with what it began with"):
        loop.train(TrainingRun(preset("tiny"), one, tmp_path, validate_every=9, validation_scenes=1))


@pytest.mark.parametrize("name", ["validate_every", "validation_scenes"])
def test_a_run_that_could_not_be_validated_is_refused_before_it_begins(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"{name} is 0, need at least 1"):
        loop.train(TrainingRun(preset("tiny"), THREE, tmp_path / "run", **{name: 0}))
    assert not (tmp_path / "run").exists()
