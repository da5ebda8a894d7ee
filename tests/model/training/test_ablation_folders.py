"""The folder of an ablation study: runs, other files, damaged scores; and wrong usage of the command."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import ablation, ablation_runs, study
from gapmes.model.training.ablation_runs import VARIANTS, Budget, run_in
from gapmes.model.training.ablation_table import COMPLETE

SMALL = Budget(steps=2, size=32, training_scenes=1, validation_scenes=2, log_rows=2)


def test_folders_of_other_names_are_not_runs(tmp_path: Path) -> None:
    for name in ("complete-seed1-old", "complete-seed", "complete-seed01", "complete-seed-1", "top-1-seedx", "notes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / ablation_runs.SCORES).write_text("{}")
    assert ablation.finished(tmp_path, SMALL) == {name: {} for name in VARIANTS}
    (tmp_path / "complete-seed1").mkdir()
    (tmp_path / "complete-seed1" / ablation_runs.SCORES).write_text("{}")
    with pytest.raises(ValueError, match=r"complete-seed1.*holds no scores"):
        ablation.finished(tmp_path, SMALL)


def test_scores_that_are_damaged_are_named(tmp_path: Path) -> None:
    run = run_in(tmp_path, COMPLETE, 1, SMALL)
    run.folder.mkdir()
    path = run.folder / ablation_runs.SCORES
    figures = {name: [1.0, 2.0] for name in ablation_runs.FIGURES}
    whole = json.dumps({**run._identity(), "parameters": 5, "minutes": 1.0, "scores": figures})
    path.write_text(whole)
    assert run.scores().psnr.tolist() == [1.0, 2.0]
    lacking, wide = json.loads(whole), json.loads(whole)
    del lacking["scores"]["ssim"]
    wide["scores"]["ssim"] = [1.0]
    flat = json.loads(whole)
    flat["scores"]["lpips"] = [1.0, 2.0, 3.0]
    for text in ("", "{}", "[]", whole[:-20], json.dumps(lacking)):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"seed1/scores\.json holds no scores of a run: .*; remove the file"):
            run.scores()
    path.write_text(json.dumps(flat))
    with pytest.raises(ValueError, match=r"scores\.json has lpips of shape \(3,\), need one number for each of the 2"):
        run.scores()
    path.write_text(json.dumps(wide))
    with pytest.raises(ValueError, match=r"scores\.json has ssim of shape \(1,\), need one number for each of the 2"):
        run.scores()


def test_a_figure_that_is_no_number_is_refused_and_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = iter([1.0, math.nan])
    monkeypatch.setattr(ablation_runs, "train", lambda *_, **__: GaPMeS(preset("tiny")))
    monkeypatch.setattr(ablation_runs, "read_rows", lambda _: [{"step": 2, "minutes": 1.0}])
    monkeypatch.setattr(ablation_runs, "validate", lambda *_: dict.fromkeys(ablation_runs.FIGURES, next(figures)))
    monkeypatch.setattr(Budget, "batches", lambda _: [None, None])
    monkeypatch.setattr(study, "default_weights", lambda: None)
    assert ablation.main([str(tmp_path), "--only", COMPLETE]) == 1
    assert "refused: psnr of scene 1 is nan, need a finite number: the run has diverged" in capsys.readouterr().err
    assert list(tmp_path.rglob("*.json")) == []
    run = run_in(tmp_path, COMPLETE, 1, SMALL)
    run.folder.mkdir(exist_ok=True)
    scores = {"parameters": 5, "minutes": 1.0, "scores": {key: [math.inf, 1.0] for key in ablation_runs.FIGURES}}
    (run.folder / ablation_runs.SCORES).write_text(json.dumps({**run._identity(), **scores}))
    with pytest.raises(ValueError, match=r"scores\.json holds no scores of a run: .*psnr of scene 0 is inf"):
        run.scores()


@pytest.mark.parametrize(("option", "value"), [("--threads", "0"), ("--threads", "99999"), ("--seeds", "-1")])
def test_numbers_out_of_range_are_wrong_usage(
    option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        ablation.main([str(tmp_path / "out"), option, value])
    assert ended.value.code == 2
    assert f"argument {option}: is {value}, need at " in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_page_that_is_filled_keeps_its_mode_and_the_link_to_it(tmp_path: Path) -> None:
    page, link = tmp_path / "page.md", tmp_path / "link.md"
    page.write_text("<!-- tables: begin -->\nold\n<!-- tables: end -->\n")
    page.chmod(0o660)
    link.symlink_to(page)
    study.fill_page(link, "| new |\n", "tables")
    assert page.read_text() == "<!-- tables: begin -->\n| new |\n<!-- tables: end -->\n"
    assert page.stat().st_mode & 0o777 == 0o660
    assert link.is_symlink()
