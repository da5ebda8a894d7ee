"""Scenes generated ahead equal those that the steps would generate, and their processes end in time."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path

import numba
import pytest
import torch
from child_processes import eventually, gone, in_a_terminal, spawned

from gapmes.model.training import ahead
from gapmes.model.training.command import BEGINS_ANEW
from gapmes.model.training.recipe import Phase, Recipe
from gapmes.model.training.run_folder import Refused
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
LARGE = replace(SMALL, phases=(Phase(1.0, (96,), 2, (2,), (0.1, 0.4)),))  # more than a pipe holds


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)


def _same(a: StepScenes, b: StepScenes) -> bool:
    tensors = (torch.equal(getattr(a.batch, field.name), getattr(b.batch, field.name)) for field in fields(TensorBatch))
    return all(tensors) and (a.torch_seed, a.withheld) == (b.torch_seed, b.withheld)


def test_they_are_the_same_to_the_bit_and_in_order() -> None:
    worker, steps = Worker(1, 2), range(1, SMALL.steps)
    with closing(ahead.drawn_steps(SMALL, steps, worker, 2)) as coming:
        found = list(coming)
    expected = [draw_step(SMALL, step, worker) for step in steps]
    assert len(found) == len(expected)
    assert all(map(_same, found, expected))
    assert not any(_same(expected[0], other) for other in expected[1:])
    assert not spawned(os.getpid())


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


def test_a_run_that_stops_ends_them() -> None:
    with closing(ahead.drawn_steps(SMALL, range(1000), Worker(), 1)) as coming:
        next(coming)
        assert len(spawned(os.getpid())) == 1
    assert not spawned(os.getpid())


def test_one_that_is_killed_while_it_hands_over_is_a_refusal() -> None:
    """The reader of half a message does not wait for the rest."""
    with ahead._started(LARGE, range(1000), Worker(), 1) as pipes:
        assert pipes[0].poll(120)  # the message has begun, and does not fit
        (process,) = spawned(os.getpid())
        os.kill(process, signal.SIGKILL)
        with pytest.raises(Refused, match=r"a process that draws scenes ended.* fewer --loaders"):
            ahead._received(pipes[0])


def test_an_error_in_one_is_told_and_a_refusal(capfd: pytest.CaptureFixture[str]) -> None:
    broken = replace(SMALL, phases=(Phase(1.0, (32,), 2, (2,), (-1.0, 0.4)),))
    with closing(ahead.drawn_steps(broken, range(1000), Worker(), 1)) as coming, pytest.raises(Refused, match="above"):
        next(coming)
    assert "Traceback" in capfd.readouterr().err


COMMAND = [sys.executable, "-m", "gapmes.model.training", "--device", "cpu", "--loaders", "2", "--quiet"]
COMMAND += ["--steps", "60"]  # longer than it is let live, and no run of hours where these tests themselves are killed


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_command_that_ends_takes_them_along_also_while_they_begin(end: signal.Signals, tmp_path: Path) -> None:
    """All of a terminal's processes hear an interrupt; one line tells of it. Of what is killed none stays."""
    with in_a_terminal([*COMMAND, "run"], tmp_path) as run:
        eventually(lambda: len(spawned(run.pid)) == 2)
        loaders = spawned(run.pid)
        if end == signal.SIGINT:
            os.killpg(run.pid, end)
        else:
            run.kill()
        _, told = run.communicate(timeout=120)
    eventually(lambda: all(map(gone, loaders)))
    assert run.returncode == (130 if end == signal.SIGINT else -end)
    if end == signal.SIGINT:
        assert told == f"stopped; the same command {BEGINS_ANEW}\n"
    else:  # the interpreter of one that has not begun may say that it has lost its parent, before any line of ours
        assert "stopped" not in told
