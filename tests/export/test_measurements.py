"""`gapmes-export --report` and `--stability`: impossible requests give one line and exit status 1, before any work."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from onnxruntime.capi.onnxruntime_pybind11_state import RuntimeException
from typer.testing import CliRunner

from gapmes.export.cli import app
from gapmes.export.tradeoff import files, run
from gapmes.export.tradeoff.child import ChildFailed, _in_child
from gapmes.export.tradeoff.page import WRITTEN


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
    assert result.output == f"refused: {options[0][2:]}: {tmp_path / 'taken'} is not a folder (name a folder)\n"
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("error", [ChildFailed("the export of x.onnx", 1), OSError(28, "No space left", "report.json")])
def test_what_fails_in_the_work_is_one_line(error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(run, "report", fails)
    words = ["--report", str(tmp_path / "out"), "--quiet"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert result.output == f"refused: {error}\n"
    told = CliRunner().invoke(app, [*words, "--json"])
    assert (told.exit_code, json.loads(told.stdout)) == (1, {"error": {"detail": str(error)}})


@pytest.mark.parametrize(
    ("option", "name", "work"),
    [
        *(("--report", name, "gapmes.export.tradeoff.files.quick_files") for name in WRITTEN),
        *(("--stability", f"stability.{end}", "gapmes.export.stability.table.all_rows") for end in ("json", "md")),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_any_work(
    option: str, name: str, work: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, None)
    (tmp_path / name).mkdir()
    result = CliRunner().invoke(app, [option, str(tmp_path), "--quiet"])
    assert result.exit_code == 1
    assert result.output == f"refused: {option[2:]}: {tmp_path / name} is a folder, need a file (name a file in it)\n"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("allocate", [torch.empty, np.empty, lambda _: reserve()])
@pytest.mark.parametrize(
    ("option", "where", "expected"),
    [
        (
            "--report",
            "gapmes.export.tradeoff.run.report",
            "measure the report{}: take --quick, which measures less, or",
        ),
        ("--stability", "gapmes.export.stability.table.stability_table", "compute the table of stability{}: take"),
    ],
)
def test_a_lack_of_memory_is_one_line(
    option: str,
    where: str,
    expected: str,
    allocate: Callable[[int], object],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(where, lambda *_, **__: allocate(2**58))
    result = CliRunner().invoke(app, [option, str(tmp_path / "out"), "--quiet"])
    assert result.exit_code == 1
    asked = re.search(r" \(\d+ bytes in one piece were asked for\)", result.output)
    begin = f"refused: not enough memory to {expected.format('' if asked is None else asked[0])}"
    assert result.output.startswith(begin)
    assert result.output.endswith(" a machine with more memory\n")
    assert result.output.count("\n") == 1


def reserve() -> None:
    raise RuntimeException("[ONNXRuntimeError] : 6 : Failed to allocate memory for requested buffer of size 9")


def test_a_child_without_memory_says_so_and_nothing_else(capfd: pytest.CaptureFixture[str]) -> None:
    for work, words in ((np.empty, "the process that measures empty"), (bytearray, "the process that measures byte")):
        with pytest.raises(ChildFailed, match=f"{words}.* had not enough memory: take --quick") as told:
            _in_child(work, 2**58)
        assert "above" not in str(told.value)
    assert capfd.readouterr().err == ""


def test_a_variant_that_lacks_memory_ends_with_the_status_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "load_variant", lambda *_: np.empty(2**58))
    with pytest.raises(SystemExit) as ended:
        files.export_variant("x.onnx", 64, 0, False)
    assert "had not enough memory" in str(ChildFailed("the export of x.onnx", ended.value.code))


def test_a_child_that_the_system_killed_may_have_lacked_memory() -> None:
    with pytest.raises(ChildFailed, match="was ended by SIGKILL; lack of memory may be why: take --quick"):
        _in_child(eval, "__import__('os').kill(__import__('os').getpid(), 9)")


def test_there_is_no_short_table_of_stability(tmp_path: Path) -> None:
    given = ["--stability", str(tmp_path / "new"), "--quick"]
    result = CliRunner().invoke(app, given, env={"COLUMNS": "200"})
    assert result.exit_code == 2
    assert "shortens --report; the table of --stability is always whole" in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_child_that_fails_is_said_by_its_work_and_status() -> None:
    with pytest.raises(ChildFailed, match=r"the process that measures eval ended with status 5, need 0"):
        _in_child(eval, "__import__('os')._exit(5)")
