"""`python -m gapmes.model.training`: numbers out of range are wrong usage, what a run refuses is one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from gapmes.model.training import run_folder
from gapmes.model.training.command import main


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--steps", "-1", "is -1, need at least 1"),
        ("--steps", "0", "is 0, need at least 1"),
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


@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_folder_in_use_is_refused_in_one_line(
    processes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_folder.claimed(tmp_path):
        assert main([str(tmp_path), "--processes", processes, "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"refused: {tmp_path}: another run is at work there")
    assert told.count("\n") == 1
