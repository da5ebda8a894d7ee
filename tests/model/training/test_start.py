"""What a run starts from is recorded in its checkpoints; scenes that were seen and unrelated runs are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch

from gapmes.model.checkpoint import read_metadata, save_checkpoint
from gapmes.model.config import preset
from gapmes.model.training import command
from gapmes.model.training.average import main as average
from gapmes.model.training.loop import train
from gapmes.model.training.recipe import Recipe
from gapmes.model.training.run_folder import WEIGHTS
from gapmes.model.training.start import BEGUN, SEEDS, seeds_of, started
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.weights_file import file_sha256


def saved(path: Path, seed: int, initial: Path | None = None) -> Path:
    """What a run with this seed begins with, as its checkpoint; no two have the same weights."""
    torch.manual_seed(seed)
    network = started(preset("tiny"), replace(Recipe(), seed=seed), initial)
    with torch.no_grad():
        next(network.parameters()).add_(1e-3 * seed)
    save_checkpoint(path, network)
    return path


@pytest.fixture
def first(tmp_path: Path) -> Path:
    return saved(tmp_path / "first.safetensors", 1)


def test_a_checkpoint_records_its_start_and_all_seeds(first: Path, tmp_path: Path) -> None:
    recipe = replace(Recipe(), steps=0, seed=13)
    train(TrainingRun(preset("tiny"), recipe, tmp_path / "run", initial=first))
    found = read_metadata(tmp_path / "run" / WEIGHTS)
    assert (found[BEGUN], found[SEEDS]) == (file_sha256(first), "1,13")
    assert read_metadata(first)[BEGUN] == "random weights of seed 1"
    assert seeds_of(found) == {1, 13}
    assert seeds_of({}) == set()


@pytest.mark.parametrize(("arguments", "told"), [(["--seed", "1"], True), (["--seed", "2"], False)])
def test_a_seed_that_the_weights_have_seen_is_told(
    arguments: list[str],
    told: bool,
    first: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command, "run_workers", Mock())
    given = [str(tmp_path / "run"), "--recipe", "finish", "--initial-weights", str(first), *arguments]
    assert command.main(given) == 0
    said = f"{first} was trained with seed 1: another --seed draws other scenes\n"
    assert capsys.readouterr().err == (said if told else "")
    assert command.main([*given, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_the_mean_of_unrelated_runs_is_warned_of(
    first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not that of runs from the same weights, one of which another went on from."""
    second = saved(tmp_path / "second.safetensors", 2, first)
    third = saved(tmp_path / "third.safetensors", 3, second)
    other = saved(tmp_path / "other.safetensors", 4)
    out = tmp_path / "mean.safetensors"
    assert average([str(out), str(second), str(third)]) == 0
    assert capsys.readouterr().err == ""
    assert read_metadata(out)[SEEDS] == "1,2,3"
    assert average([str(out), str(second), str(other)]) == 0
    both = f"{file_sha256(first)}, random weights of seed 4"
    assert capsys.readouterr().err.startswith(f"warning: the runs began from 2 different weights ({both}); ")
