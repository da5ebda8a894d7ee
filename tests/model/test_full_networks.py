"""The paper's sizes: trained parameters, a common trunk interface, and frozen parts that stay frozen and load published
weights."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from full_networks import miniature, weights_of_another
from small_networks import scene

from gapmes.model.checkpoint import load_checkpoint, save_checkpoint, shipped_checkpoint
from gapmes.model.config import preset
from gapmes.model.cost_volume import Views
from gapmes.model.full_trunk import FullTrunk
from gapmes.model.network import GaPMeS
from gapmes.model.pretrained.backbones import RECORD, BackboneSources, load_backbones
from gapmes.model.training import command
from gapmes.model.training.command import main as train_command
from gapmes.model.training.recipe import FINISH, Recipe
from gapmes.model.training.run_folder import WEIGHTS
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.trunk import LightTrunk
from gapmes.model.weights_file import CheckpointError

PAPER = 14.6e6  # trained parameters
DOCUMENTED = {"depth": 5_348_622, "mixture": 8_574_732, "heads": 366_008, "mono_context": 172_256}


def trained_by_module(network: GaPMeS) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, value in network.named_parameters():
        if value.requires_grad:
            part = name.split(".")[0]
            found[part] = found.get(part, 0) + value.numel()
    return found


def test_base_trains_as_many_parameters_as_the_paper() -> None:
    with torch.device("meta"):
        network = GaPMeS(preset("base"))
    assert network.trainable_parameters() == pytest.approx(PAPER, rel=0.02)
    assert trained_by_module(network) == DOCUMENTED
    page = (Path(__file__).parents[2] / "docs" / "checkpoints.md").read_text()
    for count in [*DOCUMENTED.values(), sum(DOCUMENTED.values())]:
        assert f"{count:,}" in page


@pytest.mark.parametrize("name", ["small", "base"])
def test_the_papers_settings(name: str) -> None:
    config = preset(name)
    assert (config.experts, config.top_k, config.temperature) == (6, 2, 0.8)
    assert config.freeze_vits
    assert config.trunk == "full"
    assert config.depth_head


def test_a_full_network_predicts_for_any_number_of_views() -> None:
    network = miniature()
    for views in (2, 3, 4):
        with torch.no_grad():
            found = network(*scene(1, views, 64))
        assert found.depth.shape == (1, views, 64, 64)
        assert found.gaussians.harmonics.shape[2] == 9
        assert all(torch.isfinite(v).all() for v in (found.gaussians.means, found.gaussians.scales, found.depth))


def test_scenes_of_a_batch_do_not_see_each_other() -> None:
    network = miniature()
    one = scene(2, 3, 64, seed=5)
    with torch.no_grad():
        both = network(*one).depth
        alone = network(*(value[1:] for value in one)).depth
    # the same products in batches of another size: measured 9e-6
    torch.testing.assert_close(both[1:], alone, atol=0, rtol=1e-4)


def test_both_trunks_give_the_same_two_maps() -> None:
    full, light = miniature(), GaPMeS(preset("tiny"))
    assert isinstance(full.trunk, FullTrunk)
    assert isinstance(light.trunk, LightTrunk)
    for network in (full, light):
        images, k, poses, near_far = scene(1, 2, 64)
        found = network.trunk(images.flatten(0, 1), Views.make(k, poses, near_far))
        assert found.half.shape == (2, network.config.half_channels, 32, 32)
        assert found.quarter.shape == (2, network.config.quarter_channels, 16, 16)


def test_the_full_trunk_says_which_channels_it_has() -> None:
    with pytest.raises(ValueError, match=r"are \(96, 64\), the full trunk has \(96, 256\)"):
        GaPMeS(preset("small", quarter_channels=64))


@pytest.fixture
def sources(tmp_path: Path) -> BackboneSources:
    return weights_of_another(tmp_path)


def test_published_weights_go_into_the_frozen_parts_and_on_record(tmp_path: Path, sources: BackboneSources) -> None:
    network, other = miniature(), miniature(seed=9)
    found = load_backbones(network, sources)
    assert list(found["trunk"].left_out) == ["feature_flow_attn.q_proj.weight"]
    for part in ("semantic.vit", "mono.model", "trunk"):
        ours, theirs = network.get_submodule(part).state_dict(), other.get_submodule(part).state_dict()
        assert all(torch.equal(ours[name], theirs[name]) for name in theirs), part
    save_checkpoint(tmp_path / "a.safetensors", network)
    loaded = load_checkpoint(tmp_path / "a.safetensors")
    record = json.loads(loaded.provenance[RECORD])
    assert {part: row["path"] for part, row in record.items()} == {
        "semantic": "dino.pth", "depth": "depth.pth", "trunk": "gmflow.pth"
    }  # fmt: skip
    assert all(len(row["sha256"]) == 64 for row in record.values())
    assert "frozen parts: not stated (depth), not stated (semantic)" in loaded.provenance["gapmes.licence"]


def test_weights_of_the_wrong_part_are_refused_with_its_name(sources: BackboneSources) -> None:
    wrong = replace(sources, trunk=sources.semantic)
    with pytest.raises(CheckpointError, match=r"trunk weights: .*missing"):
        load_backbones(miniature(), wrong)
    with pytest.raises(CheckpointError, match="preset tiny has no parts"):
        load_backbones(GaPMeS(preset("tiny")), sources)


def test_the_command_asks_for_the_weights_that_a_preset_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        train_command([str(tmp_path), "--preset", "base", "--semantic-weights", "x"])
    assert "give --depth-weights, --trunk-weights" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        train_command([str(tmp_path), "--trunk-weights", "x"])
    assert "preset tiny has no such frozen part: leave out --trunk-weights" in capsys.readouterr().err


def test_the_ablation_without_depth_takes_no_depth_weights(sources: BackboneSources) -> None:
    torch.manual_seed(0)
    network = GaPMeS(replace(miniature().config, without_depth=True))
    assert set(load_backbones(network, replace(sources, depth=None))) == {"semantic", "trunk"}
    with pytest.raises(CheckpointError, match="has no depth stream, but depth weights are given"):
        load_backbones(network, sources)
    with pytest.raises(CheckpointError, match="needs depth weights"):
        load_backbones(miniature(), replace(sources, depth=None))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--recipe", "finish"], "goes on from trained weights: give --initial-weights"),
        (["--initial-weights", "OUT/weights.safetensors"], "lies in the run's own folder"),
        (["--initial-weights", "nope.safetensors"], "nope.safetensors: no such file"),
        (
            ["--initial-weights", "TINY", "--without-tasks"],
            "has another configuration than this run: without_tasks is False, asked for True; give the preset",
        ),
        (["--initial-weights", "TINY", "--depth-weights", "x"], "carries its frozen parts: leave out --depth-weights"),
        (["--preset", "small", "--initial-weights", "TINY"], "has another configuration"),
    ],
)
def test_weights_to_start_from_are_checked_before_anything_is_done(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"TINY": str(shipped_checkpoint("tiny")), "OUT/weights.safetensors": str(tmp_path / "out" / WEIGHTS)}
    with pytest.raises(SystemExit):
        train_command([str(tmp_path / "out"), *(names.get(item, item) for item in arguments)])
    assert expected in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_the_command_takes_recipe_steps_and_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[TrainingRun] = []
    monkeypatch.setattr(command, "run_workers", lambda _count, _threads, _work, run, _quiet: given.append(run))
    start = shipped_checkpoint("tiny")
    train_command([str(tmp_path), "--recipe", "finish", "--initial-weights", str(start), "--seed", "5"])
    train_command([str(tmp_path), "--steps", "7"])
    finish, whole = given
    assert finish.recipe == replace(FINISH, seed=5)
    assert whole.recipe == replace(Recipe(), steps=7)
    assert finish.initial == start
    assert whole.initial is None


def test_weights_that_are_not_there_are_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = str(tmp_path / "nope.pth")
    arguments = [item for part in ("semantic", "depth", "trunk") for item in (f"--{part}-weights", missing)]
    with pytest.raises(SystemExit):
        train_command([str(tmp_path), "--preset", "small", *arguments])
    assert "nope.pth" in capsys.readouterr().err
