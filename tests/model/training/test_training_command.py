"""`python -m gapmes.model.training`: numbers out of range are wrong usage, a refusal is one line, and zero steps are a
run."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch

from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import ablation, arguments, command, run_folder
from gapmes.model.training.command import main
from gapmes.model.training.recipe import Recipe
from gapmes.model.training.workers import Worker


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--steps", "-1", "is -1, need at least 0"),
        ("--steps", "many", "invalid whole number value: 'many'"),
        ("--validate-every", "0", "is 0, need at least 1"),
        ("--threads", "0", "is 0, need at least 1"),
        ("--threads", "99999", "is 99999, need at most"),
        ("--seed", "-1", "is -1, need at least 0"),
        ("--seed", "9" * 30, f"is {'9' * 30}, need at most {2**63 - 1}"),
        ("--device", "foo", "is 'foo', need cpu, cuda, cuda:NUMBER or auto"),
        ("--device", "cuda:", "is 'cuda:', need cpu, cuda, cuda:NUMBER or auto"),
        ("--device", "cuda:٣", "is 'cuda:٣', need cpu, cuda, cuda:NUMBER or auto"),
        ("--device", "cuda", "is 'cuda', but torch finds 0 graphics cards here: give cpu or auto"),
        ("--loaders", "-1", "is -1, need at least 0"),
        ("--scenes", "0", "is 0, need at least 1"),
        ("--processes", "0", "is 0, need at least 1"),
        ("--processes", "3", "3 cannot share the 4 scenes of a step at 64 px evenly; give --scenes 3 or a multiple"),
        ("--processes", "4", "4 cannot share the 2 scenes of a step at 96 px evenly; give --scenes 4 or a multiple"),
    ],
)
def test_numbers_out_of_range_are_wrong_usage(
    option: str,
    value: str,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "run"), option, value])
    assert ended.value.code == 2
    assert f"argument {option}" in (told := " ".join(capsys.readouterr().err.split()))
    assert said in told
    assert not (tmp_path / "run").exists()


def test_no_steps_write_untrained_weights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [str(tmp_path), "--steps", "0", "--seed", "4", "--json", "--quiet"]
    for _ in range(2):  # the second finds the first one's folder
        assert main(given) == 0
        weights = tmp_path / run_folder.WEIGHTS
        assert json.loads(capsys.readouterr().out) == {"weights": str(weights), "last": None}
        torch.manual_seed(4)
        start = GaPMeS(preset("tiny"))
        found = load_checkpoint(weights)
        assert all(torch.equal(a, b) for a, b in zip(found.parameters(), start.parameters(), strict=True))


def test_weights_to_start_from_that_are_no_numbers_are_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = GaPMeS(preset("tiny"))
    next(network.parameters()).data.fill_(torch.nan)
    run_folder.save_weights(tmp_path, network, 0)
    given = ["--initial-weights", str(tmp_path / run_folder.WEIGHTS), "--steps", "0", "--quiet"]
    with pytest.raises(SystemExit, match="2"):
        main([str(tmp_path / "run"), *given])
    assert "not finite" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_threads_are_bounded_by_what_numba_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for given, said in ((None, "numba has no more on this machine"), ("2", "NUMBA_NUM_THREADS is 2")):
        monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
        if given:
            monkeypatch.setenv("NUMBA_NUM_THREADS", given)
        with pytest.raises(SystemExit):
            main([str(tmp_path / "run"), "--threads", "10000"])
        assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_folder_in_use_is_refused_in_one_line(
    processes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_folder.claimed(tmp_path):
        assert main([str(tmp_path), "--processes", processes, "--quiet", "--json"]) == 1
    printed, told = capsys.readouterr()
    assert json.loads(printed) == {"error": {"detail": told.removeprefix("refused: ").removesuffix("\n")}}
    assert told.startswith(f"refused: {tmp_path}: another run is at work there")
    assert told.count("\n") == 1


def test_a_graphics_card_is_taken_where_torch_finds_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for cards, found in ((0, "cpu"), (2, "cuda")):
        monkeypatch.setattr(torch.cuda, "is_available", lambda cards=cards: cards > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda cards=cards: cards)
        assert arguments.device("auto") == found
    assert arguments.device("cuda:1") == arguments.device("cuda:01") == "cuda:1"
    with pytest.raises(argparse.ArgumentTypeError, match="is 'cuda:2', but torch finds 2"):
        arguments.device("cuda:2")


@pytest.mark.parametrize("below", ["", "run"])
def test_a_place_that_is_no_folder_is_refused_in_one_line(
    below: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").touch()
    out = tmp_path / "taken" / below
    assert main([str(out), "--steps", "0", "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {out} cannot be the folder of a run: ")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (run_folder.STATE, b"", "cannot be read as the state of a run (EOFError: "),
        (
            run_folder.STATE,
            b"PK\x03\x04 cut short",
            "it is damaged or of another version: use a new folder",
        ),
        (run_folder.LOG, b"text\n", "line 1 is no row of a training log"),
        (run_folder.LOG, b'{"step": "1", "minutes": 0}\n', "line 1 is no row of a training log"),
        (run_folder.LOG, b"\xff\n", "is no training log, it is no text"),
    ],
)
def test_a_damaged_file_of_a_run_is_named_and_left(
    name: str, content: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(content)
    assert main([str(tmp_path), "--steps", "0", "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {tmp_path / name}")
    assert said in told
    assert told.count("\n") == 1
    assert (tmp_path / name).read_bytes() == content


def test_a_run_may_have_another_number_of_scenes_in_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = Mock()
    monkeypatch.setattr(command, "run_workers", ran)
    assert command.main([str(tmp_path), "--scenes", "12", "--processes", "3", "--quiet"]) == 0
    processes, _, _, run, _ = ran.call_args.args
    assert processes == 3
    recipe = run.recipe
    assert [phase.scenes for phase in recipe.phases] == [12] * len(Recipe().phases)
    assert replace(recipe, phases=Recipe().phases) == Recipe()


@pytest.mark.parametrize(("given", "found"), [([], 0), (["--loaders", "3"], 3)])
def test_scenes_are_drawn_ahead_by_as_many_processes_as_are_asked_for(
    given: list[str], found: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = Mock()
    monkeypatch.setattr(command, "train", ran)
    monkeypatch.setattr(command, "run_workers", lambda count, threads, work, *rest: work(Worker(), *rest))
    assert command.main([str(tmp_path), "--quiet", *given]) == 0
    assert ran.call_args.args[0].loaders == found


def test_a_place_without_a_name_is_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of a shell variable without a value: it would be the working directory."""
    monkeypatch.chdir(tmp_path)
    for main_of in (command.main, ablation.main):
        with pytest.raises(SystemExit) as ended:
            main_of(["", "--steps", "0"])
        assert ended.value.code == 2
        assert (
            "argument out: is empty, need the name of a folder; the working directory is ." in capsys.readouterr().err
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("saved", [False, True])
def test_an_interrupt_says_from_where_the_run_goes_on(
    saved: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        if saved:
            (tmp_path / run_folder.STATE).touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_workers", interrupted)
    assert command.main([str(tmp_path), "--quiet"]) == 130
    then = "goes on from the last state" if saved else "begins anew: it saves a state every 120 s, and had saved none"
    assert capsys.readouterr().err == f"stopped; the same command {then}\n"


def test_a_full_disk_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(tmp_path / "state.pt.part"))

    monkeypatch.setattr(command, "run_workers", full)
    assert command.main([str(tmp_path), "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told == f"refused: [Errno 28] No space left on device: '{tmp_path / 'state.pt.part'}'\n"
