"""The ablation study: its variants, its paired statistics, its tables, and an interrupted small study."""

from __future__ import annotations

import io
import json
import math
from dataclasses import asdict, fields, replace
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from random_lpips import random_weights
from rich.console import Console

from gapmes.model.config import ModelConfig, preset
from gapmes.model.training import ablation, ablation_runs
from gapmes.model.training.ablation_runs import VARIANTS, Budget, Run, run_in
from gapmes.model.training.ablation_table import (
    COMPLETE,
    PAPER,
    Scores,
    check_comparable,
    paired,
    tables,
    with_tables,
)
from gapmes.model.training.lpips import Lpips
from gapmes.model.training.training_run import TrainingRun
from gapmes.model.weights_file import CheckpointError

SMALL = Budget(steps=2, size=32, training_scenes=1, validation_scenes=2, log_rows=2)
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"
NAMES = [COMPLETE, "without-experts"]


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)
    numba.set_num_threads(1)


def quiet() -> Console:
    return Console(file=io.StringIO(), highlight=False, soft_wrap=True)


def drawn_scores(random: np.random.Generator, scenes: int, shift: float = 0.0) -> Scores:
    psnr, ssim, depth = random.normal(24 + shift, 3, scenes), random.uniform(0.5, 1, scenes), random.random(scenes)
    return Scores(1_000_000, 3.0, psnr, ssim, depth, np.full(scenes, 18.0))


def test_the_variants_are_the_rows_of_the_papers_tables() -> None:
    complete = preset("tiny")
    assert (complete.temperature, complete.experts, complete.top_k) == (0.8, 6, 2)
    settings = {name: preset("tiny", **changes) for name, changes in VARIANTS.items()}
    assert settings[COMPLETE] == complete
    changed = {
        name: {f.name: getattr(config, f.name) for f in fields(ModelConfig) if not same(config, complete, f.name)}
        for name, config in settings.items()
        if name != COMPLETE
    }
    table5 = [{"without_depth": True}, {"without_experts": True}, {"without_tasks": True}]
    table6 = [{"temperature": 0.4}, {"temperature": 0.6}, {"experts": 4}, {"experts": 8}, {"top_k": 1}]
    assert list(changed.values()) == table5 + table6
    assert [name for rows in PAPER.values() for name in rows] == list(changed)


def same(a: ModelConfig, b: ModelConfig, name: str) -> bool:
    return bool(getattr(a, name) == getattr(b, name))


def test_all_variants_share_recipe_and_scenes(tmp_path: Path) -> None:
    """A variant affects only its configuration and its folder."""
    budget = Budget()
    runs = [run_in(tmp_path, name, 1, budget) for name in VARIANTS]
    assert len({run.folder for run in runs}) == len(runs)
    identities = [run._identity() for run in runs]
    assert all(i["recipe"] == identities[0]["recipe"] and i["budget"] == identities[0]["budget"] for i in identities)
    recipe = budget.recipe(1)
    assert {(p.sizes, p.scenes, p.views) for p in (recipe.phase(step) for step in range(600))} == {((64,), 4, (2,))}
    assert recipe.steps == 600
    assert {name for name, value in asdict(budget.recipe(2)).items() if value != asdict(recipe)[name]} == {"seed"}
    small = SMALL.batches()
    assert len(small) == 2
    assert all(torch.equal(a.targets, b.targets) for a, b in zip(small, SMALL.batches(), strict=True))


def test_paired_differences_match_brute_force() -> None:
    random = np.random.default_rng(4)
    for seeds, scenes in ((1, 2), (1, 64), (3, 5), (2, 64)):
        values, reference = random.normal(24, 3, (seeds, scenes)), random.normal(23, 3, (seeds, scenes))
        result = paired(values, reference)
        by_scene = [sum(values[s, n] - reference[s, n] for s in range(seeds)) / seeds for n in range(scenes)]
        by_seed = [sum(values[s, n] - reference[s, n] for n in range(scenes)) / scenes for s in range(seeds)]
        # sums of at most 128 numbers near 24 in another order: measured below 1e-13
        assert result.mean == pytest.approx(sum(by_scene) / scenes, abs=1e-12)
        assert result.scene_error == pytest.approx(brute_error(by_scene), abs=1e-12)
        if seeds > 1:
            assert result.seed_error == pytest.approx(brute_error(by_seed), abs=1e-12)
        else:
            assert math.isnan(result.seed_error)


def brute_error(values: list[float]) -> float:
    mean = sum(values) / len(values)
    return math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1) / len(values))


def test_pairing_removes_what_both_have_in_common() -> None:
    """Scenes differ by 10 dB, the variants by exactly 0.3 dB: the difference is certain."""
    reference = np.linspace(18, 28, 64)[None]
    result = paired(reference - 0.3, reference)
    assert result.mean == pytest.approx(-0.3)
    assert result.scene_error < 1e-12
    with pytest.raises(ValueError, match=r"\(1, 63\).*\(1, 64\)"):
        paired(reference[:, 1:], reference)


def test_tables_show_differences_over_the_seeds_that_both_have() -> None:
    random = np.random.default_rng(1)
    results = {name: {} for name in VARIANTS}
    results[COMPLETE] = {1: drawn_scores(random, 8), 2: drawn_scores(random, 8)}
    results["top-1"] = {2: drawn_scores(random, 8), 3: drawn_scores(random, 8, 100.0)}
    text = tables(results, "caption")
    row = next(line for line in text.splitlines() if line.startswith("| top-1") and "SSIM 0.691" in line)
    expected = paired(results["top-1"][2].psnr[None], results[COMPLETE][2].psnr[None])
    assert f"| {expected.mean:+.2f} ± {expected.scene_error:.2f} |" in row
    assert "without-depth" not in text
    assert "Table 5" not in text


def test_tables_have_means_over_seeds_both_errors_and_shares_of_the_complete_model() -> None:
    def scores(minutes: float, ssim: float, *psnr: float) -> Scores:
        return Scores(1_000_000, minutes, np.array(psnr), np.full(2, ssim), np.full(2, 0.1), np.full(2, 18.0))

    results = {
        COMPLETE: {1: scores(3.0, 0.8, 20.0, 20.0), 2: scores(5.0, 0.8, 20.0, 20.0)},
        "top-1": {1: scores(1.0, 0.8 - 1e-6, 14.0, 16.0), 2: scores(1.0, 0.8 - 1e-6, 15.0, 19.0)},
        "tau-0.4": {3: scores(1.0, 0.8, 20.0, 20.0)},  # no seed of the complete model
    }
    text = tables(results, "caption")
    assert "| complete | 2 | 1,000,000 | 4.0 | 20.00 |" in text
    assert "| top-1 | -4.00 ± 1.50 (seeds ± 1.00) | +0.0000 ± 0.0000 (seeds ± 0.0000) |" in text
    assert "| -20.0 % | +0.0 % | SSIM 0.691" in text
    assert text.count("| tau-0.4 |") == 1


def test_tables_say_which_runs_were_scored_without_lpips() -> None:
    random = np.random.default_rng(3)
    plain, other = drawn_scores(random, 8), drawn_scores(random, 8)
    with_lpips = replace(plain, lpips=random.random(8)), replace(other, lpips=random.random(8))
    assert "LPIPS" not in tables({COMPLETE: {1: plain}, "top-1": {1: other}}, "caption")
    text = tables({COMPLETE: {1: with_lpips[0]}, "top-1": {1: with_lpips[1]}, "tau-0.4": {1: other}}, "caption")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    reached, differences = rows[:5], rows[5:]
    assert [row[reached[0].index("LPIPS")] for row in reached[2:]] == [
        f"{with_lpips[0].lpips.mean():.4f}",
        f"{with_lpips[1].lpips.mean():.4f}",
        "–",
    ]
    column = differences[0].index("LPIPS")
    by_name = {row[0]: row[column] for row in differences[2:]}
    expected = paired(with_lpips[1].lpips[None], with_lpips[0].lpips[None])
    assert by_name["tau-0.4"] == "–"
    assert by_name["top-1"] == f"{expected.mean:+.4f} ± {expected.scene_error:.4f}"
    assert {len(row) for row in differences} == {len(differences[0])}


def test_runs_on_different_scenes_are_not_compared() -> None:
    random = np.random.default_rng(2)
    same, other = drawn_scores(random, 4), drawn_scores(random, 4)
    check_comparable({COMPLETE: {1: same, 2: other}, "top-1": {1: other}, "tau-0.4": {}})
    other = replace(other, copy_psnr=same.copy_psnr + np.array([0, 0, 0.002, 0]))
    with pytest.raises(ValueError, match=r"complete \(seed 1\) and top-1 \(seed 3\).*scene 2"):
        check_comparable({COMPLETE: {1: same}, "top-1": {3: other}})
    with pytest.raises(ValueError, match=r"complete \(seed 1\) was scored on 4 scenes, top-1 \(seed 3\) on 1;"):
        check_comparable({COMPLETE: {1: same}, "top-1": {3: drawn_scores(random, 1)}})


def test_runs_with_lpips_of_different_weights_are_not_compared() -> None:
    plain = drawn_scores(np.random.default_rng(2), 4)
    one, two = (replace(plain, lpips=np.ones(4), lpips_weights=name) for name in ("a", "b"))
    check_comparable({COMPLETE: {1: one, 2: one}, "top-1": {1: plain}})
    with pytest.raises(ValueError, match=r"complete \(seed 1\) and top-1 \(seed 2\).*different weights for LPIPS"):
        check_comparable({COMPLETE: {1: one}, "top-1": {1: plain, 2: two}})


def test_tables_take_the_place_between_the_markers() -> None:
    page = f"before\n{BEGIN}\nold\n{END}\nafter\n"
    once = with_tables(page, "| new |\n", "tables")
    assert once == f"before\n{BEGIN}\n| new |\n{END}\nafter\n"
    assert with_tables(once, "| new |\n", "tables") == once
    for broken in ("no markers", page + BEGIN, f"{END}{BEGIN}"):
        with pytest.raises(ValueError, match="need one of each"):
            with_tables(broken, "", "tables")


def test_the_documented_page_can_be_filled_and_names_every_variant() -> None:
    page = (Path(__file__).parents[3] / "docs" / "ablations.md").read_text(encoding="utf-8")
    with_tables(page, "", "tables")
    with_tables(page, "", "silenced")
    assert all(f"`{name}`" in page for name in VARIANTS)


def test_an_interrupted_study_resumes_and_repeats_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, trained = ablation_runs.train, []

    def counted(run: TrainingRun) -> object:
        trained.append(run.config)
        if len(trained) == 2:
            raise KeyboardInterrupt
        return real(run)

    monkeypatch.setattr(ablation_runs, "train", counted)
    with pytest.raises(KeyboardInterrupt):
        ablation.ablate(tmp_path, NAMES, [1], SMALL, quiet())
    first = json.loads((tmp_path / ablation.RESULT).read_text())
    assert list(first["variants"]) == [COMPLETE]

    console = quiet()
    results = ablation.ablate(tmp_path, NAMES, [1], SMALL, console)
    assert [config.without_experts for config in trained] == [False, True, True]
    assert "run 1 of 1  without-experts (seed 1)  step 2/2" in console.file.getvalue()
    again = ablation.ablate(tmp_path, NAMES, [1], SMALL, quiet())
    assert len(trained) == 3

    body = json.loads((tmp_path / ablation.RESULT).read_text())
    assert body["variants"][COMPLETE] == first["variants"][COMPLETE]
    for name in NAMES:
        assert len(results[name][1].psnr) == SMALL.validation_scenes
        assert (
            again[name][1].psnr.tolist() == results[name][1].psnr.tolist() == body["variants"][name]["runs"][0]["psnr"]
        )
    # the same scenes: what does not depend on the model is equal to the bit
    assert results[COMPLETE][1].copy_psnr.tolist() == results["without-experts"][1].copy_psnr.tolist()
    assert results[COMPLETE][1].parameters > results["without-experts"][1].parameters
    text = (tmp_path / ablation.TABLES).read_text()
    assert "| without-experts | 1 |" in text
    assert "PSNR -21.9 %" in text

    with pytest.raises(ValueError, match=r"steps is 2, asked for 3"):
        ablation.ablate(tmp_path, NAMES, [1], Budget(**{**asdict(SMALL), "steps": 3}), quiet())


def test_what_was_scored_without_lpips_is_scored_again_and_not_trained_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet())[COMPLETE][1]
    assert before.lpips is None
    folder, distance = tmp_path / "complete-seed1", Lpips(random_weights())
    (folder / "state.pt").unlink()  # without it a training would begin anew

    def trains(*_: object, **__: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(ablation_runs, "train", trains)
    after = ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet(), distance)[COMPLETE][1]
    assert after.psnr.tolist() == before.psnr.tolist()
    assert after.lpips.shape == (SMALL.validation_scenes,)
    assert (after.lpips > 0).all()
    assert len(set(after.lpips.tolist())) == SMALL.validation_scenes
    # what is there stays, asked for or not
    for asked in (None, distance):
        kept = ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet(), asked)[COMPLETE][1]
        assert kept.lpips.tolist() == after.lpips.tolist()
    assert "LPIPS" in (tmp_path / ablation.TABLES).read_text()
    body = json.loads((tmp_path / ablation.RESULT).read_text())
    assert body["variants"][COMPLETE]["runs"][0]["lpips"] == after.lpips.tolist()

    other = {name: 1.5 * value for name, value in random_weights().items()}
    again = ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet(), Lpips(other))[COMPLETE][1]
    assert again.lpips.tolist() != after.lpips.tolist()
    # what was not asked for would keep the others': refused before anything is written
    top = run_in(tmp_path, "top-1", 1, SMALL)
    top.folder.mkdir()
    top._keep(again)
    for asked, weights in ((["top-1"], distance), ([COMPLETE], distance)):
        with pytest.raises(ValueError, match="different weights for LPIPS"):
            ablation.ablate(tmp_path, asked, [1], SMALL, quiet(), weights)
        assert run_in(tmp_path, asked[0], 1, SMALL).scores().lpips_weights == again.lpips_weights
    (top.folder / ablation_runs.SCORES).unlink()
    # scores that the weights do not have are not mixed with what the weights have
    path = folder / ablation_runs.SCORES
    whole = json.loads(path.read_text())
    path.write_text(json.dumps(whole | {"scores": whole["scores"] | {"psnr": [1.0, 2.0]}}))
    with pytest.raises(ValueError, match=r"weights\.safetensors has psnr .* in scene 0, scores\.json says 1\.00 dB"):
        ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet(), distance)
    (folder / "weights.safetensors").unlink()
    with pytest.raises(CheckpointError, match="no such file"):
        ablation.ablate(tmp_path, [COMPLETE], [1], SMALL, quiet(), distance)


def test_a_half_written_log_is_read_to_its_last_whole_row(tmp_path: Path) -> None:
    run = Run(COMPLETE, 1, SMALL, tmp_path)
    assert run.step() == 0
    (tmp_path / "log.jsonl").write_text('{"step": 1, "minutes": 0.1}\n{"st')
    assert run.step() == 1


def test_the_command_refuses_before_it_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text("no markers")
    assert ablation.main([str(tmp_path / "out"), "--page", str(page)]) == 1
    assert ablation.main([str(tmp_path / "out"), "--steps", "0"]) == 1
    assert "steps is 0, need at least 1" in capsys.readouterr().err
    assert ablation.main([str(tmp_path / "out"), "--lpips", str(page)]) == 1
    assert "page.md cannot be read as safetensors" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
