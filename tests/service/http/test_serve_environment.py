"""`gapmes serve` and the environment: what counts as a setting, what does not, and what others have set."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from cli_runs import run
from served_process import serving

from gapmes.service.commands import serve
from gapmes.service.process.peers import FOLDER

STARTS_NOTHING = """
import sys, uvicorn
from gapmes.service.cli import main
uvicorn.run = lambda *_, **__: None
main(["serve", "--port", "0", "--workers", "2", "--store", sys.argv[1]])
"""


@pytest.mark.parametrize("said", ["3", "auto"])
def test_the_number_of_processes_is_that_of_the_settings_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str
) -> None:
    """Hosts set WEB_CONCURRENCY, which the server reads: its processes would know nothing of one another."""
    found: list[dict[str, Any]] = []
    monkeypatch.setattr(uvicorn, "run", lambda _, **options: found.append(options))
    monkeypatch.setattr("signal.signal", lambda *_: None)
    for name, value in (("WEB_CONCURRENCY", said), ("GAPMES_PORT", "0"), ("GAPMES_STORE", str(tmp_path))):
        monkeypatch.setenv(name, value)
    assert run("serve") == 0
    assert uvicorn.Config("", **{**found[0], "log_config": None}).workers == 1


def test_one_process_shares_its_numbers_with_no_other_program(tmp_path: Path) -> None:
    """The folder may not be there, and what others have counted in it is not the service's."""
    code = (
        "import uvicorn; uvicorn.run = lambda *_, **__: None\n"
        "from gapmes.service import cli\n"
        f"try: cli.main(['serve', '--port', '0', '--store', {str(tmp_path)!r}])\n"
        "except SystemExit: from gapmes.service import metrics; print(metrics.SHARED)"
    )
    environment = os.environ | {FOLDER: str(tmp_path / "none")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout == "False\n"


def test_an_empty_option_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It counts as not given, as a variable does: the setting holds, and neither every address nor this folder."""
    found: list[dict[str, Any]] = []
    monkeypatch.setattr(uvicorn, "run", lambda _, **options: found.append(options))
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setenv("GAPMES_STORE", str(tmp_path / "scenes"))
    monkeypatch.setenv("GAPMES_PORT", "0")
    monkeypatch.chdir(tmp_path)
    empty = [word for name in ("host", "store", "model", "models", "engine") for word in (f"--{name}", "")]
    assert run("serve", *empty) == 0
    assert found[0]["host"] == "127.0.0.1"
    assert [path.name for path in tmp_path.iterdir()] == ["scenes"]
    assert os.environ["GAPMES_STORE"] == str(tmp_path / "scenes")


def test_names_that_nothing_reads_are_in_the_log_once(tmp_path: Path) -> None:
    environment = os.environ | {"GAPMES_LOG": "json", "GAPMES_QUEUE": "5", "GAPMES_STORE_PORT": "tcp://10.0.0.1:80"}
    words = [sys.executable, "-c", STARTS_NOTHING, str(tmp_path)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    said = json.loads(done.stderr)  # one line
    assert said["level"] == "warning"
    assert said["message"].startswith("nothing reads GAPMES_QUEUE, GAPMES_STORE_PORT: ")


def test_names_that_nothing_reads_are_said_before_models_are_prepared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    said: list[str] = []
    monkeypatch.setattr(serve, "_prepare", lambda *_: said.append(caplog.text))
    monkeypatch.setenv("GAPMES_QUEUE", "5")
    assert run("serve", "--prepare", "--store", tmp_path) == 0
    assert ["nothing reads GAPMES_QUEUE: " in text for text in said] == [True]


def test_a_folder_for_kernels_that_cannot_be_written_is_told_and_not_used(tmp_path: Path, standin_model: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    more = {"NUMBA_CACHE_DIR": str(tmp_path / "file" / "kernels"), "GAPMES_LOG": "json"}
    with serving(tmp_path / "scenes", standin_model, tmp_path / "log", **more):
        pass
    said = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    told = [line["message"] for line in said if line["level"] == "warning"]
    assert len(told) == 1
    assert told[0].startswith(f"NUMBA_CACHE_DIR: {tmp_path / 'file' / 'kernels'}/kernels-")
    assert " cannot be written: Not a directory; compiled kernels are kept in /" in told[0]
