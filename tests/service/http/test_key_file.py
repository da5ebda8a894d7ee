"""The key of a service of several processes, read from a file."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from cli_runs import run

from gapmes.service.settings import Settings


def test_the_key_of_a_file_is_read_once_for_all_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that comes in place of another would find the file gone, or ask for another key than the others do."""
    found: list[str | None] = []
    (tmp_path / "key").write_text("sesame\n")

    def workers(*_: Any, **__: Any) -> None:
        (tmp_path / "key").write_text("another")
        found.append(Settings().key())
        (tmp_path / "key").unlink()
        found.append(Settings().key())

    monkeypatch.setattr(uvicorn, "run", workers)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setenv("GAPMES_API_KEY", "")
    monkeypatch.setenv("GAPMES_API_KEY_FILE", str(tmp_path / "key"))
    monkeypatch.setenv("GAPMES_STORE", str(tmp_path / "scenes"))
    monkeypatch.setenv("GAPMES_PORT", "0")
    assert run("serve") == 0
    assert found == ["sesame", "sesame"]
