"""`python -m gapmes.model.training`: numbers out of range are wrong usage, what a run refuses is one line, and no
steps are a run too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from gapmes.model.checkpoint import load_checkpoint
from gapmes.model.config import preset
from gapmes.model.network import GaPMeS
from gapmes.model.training import run_folder
from gapmes.model.training.command import main


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--steps", "-1", "is -1, need at least 0"),
        ("--steps", "many", "invalid whole number value: 'many'"),
        ("--validate-every", "0", "is 0, need at least 1"),
        ("--threads", "0", "is 0, need at least 1"),
        ("--processes", "0", "invalid choice: 0"),
        ("--processes", "3", "invalid choice: 3"),
    ],
)
def test_numbers_out_of_range_are_wrong_usage(
    option: str, value: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "run"), option, value])
    assert ended.value.code == 2
    assert f"argument {option}" in (told := capsys.readouterr().err)
    assert said in told
    assert not (tmp_path / "run").exists()


def test_no_steps_write_untrained_weights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(tmp_path), "--steps", "0", "--seed", "4", "--json", "--quiet"]
    for _ in range(2):  # the second finds the first one's folder
        assert main(arguments) == 0
        weights = tmp_path / run_folder.WEIGHTS
        assert json.loads(capsys.readouterr().out) == {"weights": str(weights), "last": None}
        torch.manual_seed(4)
        start = GaPMeS(preset("tiny"))
        found = load_checkpoint(weights)
        assert all(torch.equal(a, b) for a, b in zip(found.parameters(), start.parameters(), strict=True))


@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_folder_in_use_is_refused_in_one_line(
    processes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_folder.claimed(tmp_path):
        assert main([str(tmp_path), "--processes", processes, "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {tmp_path}: another run is at work there")
    assert told.count("\n") == 1
