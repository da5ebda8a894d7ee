"""Runs of a full network: frozen parts stay frozen, and a run keeps to those that it began with."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from full_networks import miniature, weights_of_another

from gapmes.model.checkpoint import load_checkpoint, save_checkpoint
from gapmes.model.network import GaPMeS
from gapmes.model.pretrained.backbones import RECORD, BackboneSources, load_backbones
from gapmes.model.training.loop import train
from gapmes.model.training.recipe import Recipe
from gapmes.model.training.run_folder import STATE, WEIGHTS
from gapmes.model.training.training_run import TrainingRun

ONE = replace(Recipe(), steps=1).with_scenes(1)


@pytest.fixture
def sources(tmp_path: Path) -> BackboneSources:
    return weights_of_another(tmp_path)


def test_a_step_changes_what_is_trained_and_nothing_that_is_frozen(tmp_path: Path) -> None:
    config = miniature().config
    torch.manual_seed(Recipe.seed)
    before = GaPMeS(config)  # as the run starts
    after = train(TrainingRun(config, ONE, tmp_path / "run", validate_every=10, validation_scenes=1))
    # the averaged weights are a mean with the start, so every trained tensor with a gradient has moved
    moved = {
        n for (n, a), b in zip(after.named_parameters(), before.parameters(), strict=True) if not torch.equal(a, b)
    }
    frozen = {name for name, value in before.named_parameters() if not value.requires_grad}
    assert not moved & frozen
    assert {name.split(".")[0] for name in moved} == {"depth", "mixture", "heads", "mono_context"}


def test_a_state_holds_what_is_trained_and_a_run_goes_on_from_it(tmp_path: Path, sources: BackboneSources) -> None:
    config = miniature().config
    whole = train(TrainingRun(config, ONE, tmp_path / "run", validation_scenes=1, backbones=sources))
    state = torch.load(tmp_path / "run" / STATE, weights_only=True)
    trained = {name for name, value in GaPMeS(config).named_parameters() if value.requires_grad}
    assert trained
    assert trained == state["model"].keys() == state["average"].keys()
    again = train(TrainingRun(config, ONE, tmp_path / "run", validation_scenes=1, backbones=sources))
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), again.parameters(), strict=True))
    torch.save(state | {"average": {}}, tmp_path / "run" / STATE)
    with pytest.raises(ValueError, match="has other tensors than this network trains"):
        train(TrainingRun(config, ONE, tmp_path / "run", validation_scenes=1, backbones=sources))


def test_a_run_does_not_go_on_with_other_frozen_weights(tmp_path: Path, sources: BackboneSources) -> None:
    config = miniature().config
    train(TrainingRun(config, ONE, tmp_path / "run", validate_every=10, validation_scenes=1, backbones=sources))
    renamed = replace(sources, semantic=str(Path(sources.semantic).with_name("renamed.pth")))
    shutil.copy(sources.semantic, renamed.semantic)
    # the same ones
    train(TrainingRun(config, ONE, tmp_path / "run", validate_every=10, validation_scenes=1, backbones=renamed))
    torch.save(miniature(seed=4).semantic.vit.state_dict(), sources.semantic)
    record = tmp_path / "run" / "semantic.checkpoint.json"
    before = record.read_text()
    for others in (sources, None):
        with pytest.raises(ValueError, match="another backbones"):
            train(TrainingRun(config, ONE, tmp_path / "run", backbones=others))
    assert record.read_text() == before


def test_a_run_takes_the_frozen_parts_of_the_weights_that_it_starts_from(
    tmp_path: Path, sources: BackboneSources
) -> None:
    config, given = miniature().config, tmp_path / "given.safetensors"
    network = miniature()
    load_backbones(network, sources)
    save_checkpoint(given, network)
    train(TrainingRun(config, ONE, tmp_path / "run", validate_every=9, validation_scenes=1, initial=given))
    found = load_checkpoint(tmp_path / "run" / WEIGHTS)
    assert found.provenance[RECORD] == network.provenance[RECORD]
    for part in ("semantic.vit", "mono.model", "trunk"):
        ours, theirs = found.get_submodule(part).state_dict(), network.get_submodule(part).state_dict()
        assert all(torch.equal(ours[name], theirs[name]) for name in theirs), part
    with pytest.raises(ValueError, match="carry the frozen parts already"):
        train(TrainingRun(config, ONE, tmp_path / "other", backbones=sources, initial=given))


def test_a_run_of_no_steps_writes_the_frozen_weights_and_an_untrained_rest(
    tmp_path: Path, sources: BackboneSources
) -> None:
    train(
        TrainingRun(miniature().config, replace(ONE, steps=0), tmp_path / "run", validation_scenes=1, backbones=sources)
    )
    loaded = load_checkpoint(tmp_path / "run" / WEIGHTS)
    other = miniature(seed=9).trunk.state_dict()
    assert all(torch.equal(value, other[name]) for name, value in loaded.trunk.state_dict().items())
    assert RECORD in loaded.provenance
