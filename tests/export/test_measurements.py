"""`gapmes-export --report` and `--stability`: impossible requests give one line and exit status 1, before any work."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from gapmes.export.cli import app
from gapmes.export.tradeoff import run
from gapmes.export.tradeoff.child import ChildFailed, _in_child


@pytest.mark.parametrize("options", [["--report"], ["--stability"], ["--report", "--stability"]])
def test_a_folder_that_cannot_be_is_refused_before_any_work(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "report", None)
    monkeypatch.setattr("gapmes.export.stability.table.stability_table", None)
    (tmp_path / "taken").touch()
    places = [str(tmp_path / "taken" / "report"), str(tmp_path / "new")][: len(options)]
    given = [item for pair in zip(options, places, strict=True) for item in pair]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 1
    assert result.output == f"refused: output: {tmp_path / 'taken'} is not a folder (name a folder)\n"
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("error", [ChildFailed("the export of x.onnx", 1), OSError(28, "No space left", "report.json")])
def test_what_fails_in_the_work_is_one_line(error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(run, "report", fails)
    result = CliRunner().invoke(app, ["--report", str(tmp_path / "out"), "--quiet"])
    assert result.exit_code == 1
    assert result.output == f"refused: {error}\n"


def test_there_is_no_short_table_of_stability(tmp_path: Path) -> None:
    given = ["--stability", str(tmp_path / "new"), "--quick"]
    result = CliRunner().invoke(app, given, env={"COLUMNS": "200"})
    assert result.exit_code == 2
    assert "shortens --report; the table of --stability is always whole" in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_child_that_fails_is_said_by_its_work_and_status() -> None:
    with pytest.raises(ChildFailed, match=r"the process that measures eval ended with status 5, need 0"):
        _in_child(eval, "__import__('os')._exit(5)")
