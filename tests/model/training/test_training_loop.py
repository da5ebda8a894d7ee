"""The training loop: a killed and resumed run ends with the weights of an uninterrupted one, and the loss falls."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from statistics import median

import numba
import pytest
import torch
from killed_runs import killed_with_a_state

from gapmes.model.checkpoint import load_checkpoint, save_checkpoint
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import loop, run_folder, step_scenes
from gapmes.model.training.log_rows import read_rows
from gapmes.model.training.recipe import FINISH, RECIPES, Phase, Recipe
from gapmes.model.training.scenes import SceneSampler
from gapmes.model.training.step import to_tensors
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.training.validation import validate, validation_batches
from gapmes.model.training.workers import Worker
from gapmes.model.weights_file import CheckpointError

SMALL = replace(
    Recipe(),
    steps=4,
    warm_up=2,
    phases=(Phase(0.5, (32,), 1, (2, 3), (0.1, 0.4)), Phase(0.5, (48,), 1, (2,), (0.1, 0.4))),
)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    one_thread()


def one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)


def run_alone(folder: Path) -> None:
    """Run in a separate process."""
    one_thread()
    loop.VALIDATION_SIZE = 64  # as in conftest.py
    run(SMALL, folder)


def run(recipe: Recipe, folder: Path, validate_every: int = 2, save_seconds: float = 0.0) -> None:
    loop.train(
        TrainingRun(
            preset("tiny"),
            recipe,
            folder,
            validate_every=validate_every,
            validation_scenes=1,
            save_seconds=save_seconds,
        )
    )


def log_of(folder: Path) -> list[dict[str, object]]:
    """The log without its times."""
    return [
        {key: value for key, value in row.items() if key != "minutes"} for row in read_rows(folder / run_folder.LOG)
    ]


def test_a_killed_run_resumes_to_the_same_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(SMALL, tmp_path / "whole", validate_every=3)
    real, done = loop._step, []

    def killed(*arguments: object) -> object:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(1)
        return real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(loop, "_step", killed)
        with pytest.raises(KeyboardInterrupt):
            run(SMALL, tmp_path / "broken", validate_every=3)
    run(SMALL, tmp_path / "broken", validate_every=3)
    whole, broken = (load_checkpoint(tmp_path / name / run_folder.WEIGHTS) for name in ("whole", "broken"))
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), broken.parameters(), strict=True))
    rows = {name: log_of(tmp_path / name) for name in ("whole", "broken")}
    assert rows["whole"] == rows["broken"]
    assert [row["step"] for row in rows["broken"]] == [3, 4]  # stopped after two steps: half of what row 3 sums up
    assert set(rows["broken"][0]["validation"]) == {"wide", "narrow"}


def test_a_run_that_was_killed_from_outside_resumes_to_the_same_weights(tmp_path: Path) -> None:
    """By SIGKILL, as soon as there is a state; a row of the log is cut short as well."""
    run(SMALL, tmp_path / "whole")
    killed_with_a_state(run_alone, tmp_path / "killed")
    assert torch.load(tmp_path / "killed" / run_folder.STATE, weights_only=True)["step"] < SMALL.steps
    with (tmp_path / "killed" / run_folder.LOG).open("a") as log:
        log.write('{"step": 4, "minu')
    run(SMALL, tmp_path / "killed")
    whole, killed = (load_checkpoint(tmp_path / name / run_folder.WEIGHTS) for name in ("whole", "killed"))
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), killed.parameters(), strict=True))
    assert [row["step"] for row in read_rows(tmp_path / "killed" / run_folder.LOG)] == [2, 4]


def test_a_log_that_is_none_is_named_and_left(tmp_path: Path) -> None:
    log = tmp_path / run_folder.LOG
    log.write_text('{"step": 1, "minutes": 0.1}\ntext\n{"step": 3, "minutes": 0.3}\n')
    with pytest.raises(ValueError, match="line 2 is no row of a training log"):
        run_folder.forget_rows_after(tmp_path, 2)
    assert len(log.read_text().splitlines()) == 3


def test_a_gradient_that_is_not_finite_moves_nothing_and_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, moved = loop.training_loss, []

    def broken(model: GaPMeS, batch: object, recipe: Recipe, step: int) -> object:
        loss, parts = real(model, batch, recipe, step)
        moved.append([p.detach().clone() for p in model.parameters()])
        return (loss * math.inf if step == 1 else loss), parts

    monkeypatch.setattr(loop, "training_loss", broken)
    recipe = replace(SMALL, steps=3, phases=(Phase(1.0, (32,), 1, (2,), (0.1, 0.4)),))
    loop.train(TrainingRun(preset("tiny"), recipe, tmp_path, validate_every=3, validation_scenes=1))
    first, second, third = moved
    assert not all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(second, third, strict=True))
    (row,) = read_rows(tmp_path / run_folder.LOG)
    assert row["train"]["skipped"] == pytest.approx(1 / 3, abs=1e-4)


def test_a_network_that_overflows_ends_the_run_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = loop.training_loss

    def diverged(model: GaPMeS, batch: object, recipe: Recipe, step: int) -> object:
        if step == 1:
            model.get_parameter("trunk.to_half.weight").data.view(-1)[0] = 1e38
        return real(model, batch, recipe, step)

    monkeypatch.setattr(loop, "training_loss", diverged)
    told = r"step 2: layer trunk\.at_half\.norm overflows: .* 1e\+38, in trunk\.to_half\.weight; .*use a new folder"
    with pytest.raises(run_folder.Refused, match=told):
        run(SMALL, tmp_path)


def test_the_loss_on_one_scene_falls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty steps on a single scene: the parts that can only fall by learning do fall. The median of three seeds."""
    batch = SceneSampler(3, "train").batch(1, 2, 2, 32, baseline=(0.2, 0.2001))
    monkeypatch.setattr(SceneSampler, "batch", lambda *_, **__: batch)
    parts: list[dict[str, float]] = []
    real = loop.training_loss

    def recorded(*arguments: object) -> object:
        loss, values = real(*arguments)
        parts.append(values)
        return loss, values

    monkeypatch.setattr(loop, "training_loss", recorded)
    plain = replace(SMALL, zoom_share=0.0, input_noise=0.0, withheld_until=0.0)  # every step the same task
    # measured over sixteen seeds: colour error to 0.41-0.65 of the first, depth error to 0.29-0.53, and once to 0.72
    limits = {"mse": 0.8, "depth": 0.6}
    shares: dict[str, list[float]] = {name: [] for name in limits}
    for seed in (1, 2, 3):
        if seed == 3 and all(value < limits[name] for name, values in shares.items() for value in values):
            break  # the median of three is below, whatever the third is
        parts.clear()
        recipe = replace(plain, steps=30, seed=seed, phases=(Phase(1.0, (32,), 1, (2,), (0.2, 0.2)),))
        run(recipe, tmp_path / str(seed), validate_every=100, save_seconds=1e9)
        for name, values in shares.items():
            values.append(parts[-1][name] / parts[0][name])
    assert all(median(values) < limits[name] for name, values in shares.items()), shares


def test_fifty_steps_on_generated_scenes_teach_it(tmp_path: Path) -> None:
    """The smoke training: the command's recipe in small, judged on scenes that it has not seen."""
    held_out = validation_batches(48, 8, (0.18, 0.5))
    torch.manual_seed(1)
    before = validate(GaPMeS(preset("tiny")), held_out)
    recipe = replace(Recipe(), steps=50, seed=1, warm_up=10, phases=(Phase(1.0, (48,), 2, (2,), (0.1, 0.5)),))
    trained = loop.train(
        TrainingRun(preset("tiny"), recipe, tmp_path, validate_every=50, validation_scenes=1, save_seconds=1e9)
    )
    after = validate(trained, held_out)
    # what needs no training already gives 23.9 dB; measured with seeds 1, 2, 3: +0.42, +0.41, +0.47 dB and
    # +0.018, +0.018, +0.017 SSIM
    assert after["psnr"] > before["psnr"] + 0.2
    assert after["ssim"] > before["ssim"] + 0.008
    assert after["psnr"] > after["copy_psnr"] + 3.0


def test_zoomed_batches_halve_the_inputs_only() -> None:
    batch = SceneSampler(5, "train").batch(1, 2, 2, 64, baseline=(0.2, 0.3))
    plain, zoomed = to_tensors(batch, zoomed=False), to_tensors(batch, zoomed=True)
    assert zoomed.images.shape[-2:] == (32, 32)
    assert zoomed.depth.shape[-2:] == (32, 32)
    assert zoomed.targets.shape == plain.targets.shape
    torch.testing.assert_close(zoomed.images.mean(), plain.images.mean(), rtol=1e-4, atol=0)
    assert torch.equal(zoomed.intrinsics, plain.intrinsics)  # normalised, so the size does not matter


def test_the_two_recipes_draw_no_scene_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes of two steps differ if the seeds of their samplers do."""
    drawn: list[int] = []

    def asked(seed: int, split: str, first: int) -> SceneSampler:
        assert (split, first) == ("train", 0)
        drawn.append(seed)
        raise InterruptedError  # the scenes need not be drawn

    monkeypatch.setattr(step_scenes, "SceneSampler", asked)
    for recipe in RECIPES.values():
        for step in range(recipe.steps):
            with pytest.raises(InterruptedError):
                step_scenes.draw_step(recipe, step, Worker())
    assert len(set(drawn)) == len(drawn) == Recipe().steps + FINISH.steps


def test_sizes_and_views_that_never_meet_are_refused() -> None:
    with pytest.raises(ValueError, match="2 sizes and 4 numbers of views, both taken in turn, do not meet"):
        Phase(1.0, (256, 128), 2, (2, 2, 2, 3), (0.06, 0.8))
    phase = FINISH.phases[-1]
    met = {(phase.sizes[s % len(phase.sizes)], phase.views[s % len(phase.views)]) for s in range(24)}
    assert met == {(128, 2), (128, 3), (256, 2), (256, 3)}


def test_recipe_schedules() -> None:
    recipe = Recipe()
    assert sum(phase.share for phase in recipe.phases) == pytest.approx(1.0)
    assert [phase.label for phase in recipe.phases] == ["64 px", "96 px", "128 px", "128 and 256 px"]
    assert [recipe.phase(s).label for s in (0, recipe.steps - 1)] == ["64 px", "128 and 256 px"]
    assert all(phase.scenes % 2 == 0 for phase in recipe.phases)  # two processes can share them
    assert recipe.noise_scale_at(0) == 1.0
    assert recipe.noise_scale_at(recipe.steps - 1) == 0.0
    assert recipe.learning_rate_at(recipe.steps - 1) < 0.04 * recipe.learning_rate
    assert recipe.depth_weight_at(0) == 1.0


def test_the_finish_takes_both_sizes_in_turn_without_noise() -> None:
    assert sum(phase.share for phase in FINISH.phases) == pytest.approx(1.0)
    assert [phase.label for phase in FINISH.phases] == ["96 px", "128 and 256 px"]
    assert all(phase.scenes % 2 == 0 for phase in FINISH.phases)  # two processes can share them
    assert {FINISH.noise_scale_at(step) for step in range(FINISH.steps)} == {0.0}
    rates = [FINISH.learning_rate_at(step) for step in range(FINISH.steps)]
    assert max(rates) == FINISH.learning_rate < Recipe().learning_rate
    assert rates[FINISH.warm_up :] == sorted(rates[FINISH.warm_up :], reverse=True)
    assert rates[-1] < 0.02 * max(rates)


def test_a_run_starts_from_given_weights(tmp_path: Path) -> None:
    torch.manual_seed(5)
    given = GaPMeS(preset("tiny"))
    save_checkpoint(tmp_path / "given.safetensors", given)
    none = replace(SMALL, steps=0)
    found = loop.train(TrainingRun(preset("tiny"), none, tmp_path / "run", initial=tmp_path / "given.safetensors"))
    assert all(torch.equal(a, b) for a, b in zip(found.parameters(), given.parameters(), strict=True))
    one = replace(SMALL, steps=1)
    options = {"validate_every": 9, "validation_scenes": 1, "save_seconds": 0.0}
    moved = loop.train(
        TrainingRun(preset("tiny"), one, tmp_path / "on", initial=tmp_path / "given.safetensors", **options)
    )
    far = [float((a - b).detach().abs().max()) for a, b in zip(moved.parameters(), given.parameters(), strict=True)]
    assert 0 < max(far) <= 1.01 * one.learning_rate_at(0)  # what AdamW moves a weight by in its first step
    again = loop.train(
        TrainingRun(preset("tiny"), one, tmp_path / "on", initial=tmp_path / "given.safetensors", **options)
    )
    assert all(torch.equal(a, b) for a, b in zip(moved.parameters(), again.parameters(), strict=True))
    with pytest.raises(ValueError, match="another initial"):
        loop.train(TrainingRun(preset("tiny"), one, tmp_path / "on", **options))


def test_weights_of_another_configuration_are_refused(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "other.safetensors", GaPMeS(preset("tiny", without_tasks=True)))
    with pytest.raises(CheckpointError, match=r"configuration than this run: without_tasks is True, asked for False"):
        loop.train(TrainingRun(preset("tiny"), SMALL, tmp_path / "run", initial=tmp_path / "other.safetensors"))


@pytest.mark.parametrize("fast", [True, False])
def test_it_computes_in_bfloat16_if_that_is_fast(fast: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[GaPMeS] = []
    monkeypatch.setattr(loop, "bfloat16_is_fast", lambda device: fast)
    monkeypatch.setattr(loop, "use_bfloat16", done.append)
    one = replace(SMALL, steps=1)
    loop.train(TrainingRun(preset("tiny"), one, tmp_path, validate_every=9, validation_scenes=1))
    assert len(done) == fast
    monkeypatch.setattr(loop, "bfloat16_is_fast", lambda device: not fast)
    with pytest.raises(ValueError, match="another precision"):
        loop.train(TrainingRun(preset("tiny"), one, tmp_path))
