"""Scenes drawn ahead are those that the steps would have drawn themselves, and their processes end when they should."""

from __future__ import annotations

import multiprocessing
import os
import signal
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path

import numba
import pytest
import torch

from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.config import preset
from gapmes.model.training import ahead, loop, run_folder
from gapmes.model.training.recipe import Phase, Recipe
from gapmes.model.training.step import TensorBatch
from gapmes.model.training.step_scenes import StepScenes, draw_step
from gapmes.model.training.workers import Worker

SMALL = replace(
    Recipe(),
    steps=6,
    warm_up=2,
    zoom_share=0.5,
    phases=(Phase(1.0, (32, 48), 2, (2, 3, 2), (0.1, 0.4)),),
)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)


def _same(a: StepScenes, b: StepScenes) -> bool:
    tensors = (torch.equal(getattr(a.batch, field.name), getattr(b.batch, field.name)) for field in fields(TensorBatch))
    return all(tensors) and (a.torch_seed, a.withheld) == (b.torch_seed, b.withheld)


@pytest.mark.parametrize("loaders", [1, 2])
def test_they_are_the_same_to_the_bit_and_in_order(loaders: int) -> None:
    worker, steps = Worker(1, 2), range(1, SMALL.steps)
    with closing(ahead.drawn_steps(SMALL, steps, worker, loaders)) as coming:
        found = list(coming)
    expected = [draw_step(SMALL, step, worker) for step in steps]
    assert len(found) == len(expected)
    assert all(map(_same, found, expected))
    assert not any(_same(expected[0], other) for other in expected[1:])
    assert not multiprocessing.active_children()


def test_a_step_has_noise_zoom_and_withheld_evidence_as_often_as_the_recipe_says() -> None:
    recipe = replace(SMALL, steps=200, phases=(Phase(1.0, (16,), 1, (2,), (0.1, 0.4)),), withheld_until=1.0)
    drawn = [draw_step(recipe, step, Worker()) for step in range(40, 100)]
    zoomed = sum(scenes.batch.targets.shape[-1] == 32 for scenes in drawn)
    noiseless = replace(recipe, input_noise=0.0)
    quiet = [draw_step(noiseless, step, Worker()) for step in range(40, 100)]
    noisy = sum(not torch.equal(a.batch.images, b.batch.images) for a, b in zip(drawn, quiet, strict=True))
    withheld = sum(scenes.withheld for scenes in drawn)
    # 60 draws with chances of 0.5, 0.5, and 0.8 falling to 0.5: within four standard deviations
    assert 15 < zoomed < 45
    assert 15 < noisy < 45
    assert 24 < withheld < 54


def test_a_run_with_them_ends_with_the_same_weights(tmp_path: Path) -> None:
    recipe = replace(SMALL, steps=3)
    for name, loaders in (("without", 0), ("with", 1)):
        loop.train(preset("tiny"), recipe, tmp_path / name, validate_every=3, validation_scenes=1, loaders=loaders)
    one, two = (load_checkpoint(tmp_path / name / run_folder.WEIGHTS) for name in ("without", "with"))
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), two.parameters(), strict=True))


def test_a_run_that_stops_ends_them() -> None:
    with closing(ahead.drawn_steps(SMALL, range(1000), Worker(), 1)) as coming:
        next(coming)
        assert len(multiprocessing.active_children()) == 1
    assert not multiprocessing.active_children()


def test_one_that_is_lost_is_a_refusal() -> None:
    with closing(ahead.drawn_steps(SMALL, range(1000), Worker(), 1)) as coming:
        next(coming)
        (process,) = multiprocessing.active_children()
        os.kill(process.pid or 0, signal.SIGKILL)
        with pytest.raises(run_folder.Refused, match=r"a process that draws scenes ended.* fewer --loaders"):
            list(coming)
