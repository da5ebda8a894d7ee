"""Standard streams that the caller has closed lead nowhere, in this process and in its children."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CHILD = "import sys; sys.exit(None in (sys.stdin, sys.stdout, sys.stderr))"
PARENT = f"""
import subprocess, sys
from gapmes.service.process.streams import open_missing
open_missing()
open_missing()
print("nowhere")
assert sys.stdin.read() == ""
assert [stream.fileno() for stream in (sys.stdin, sys.stdout, sys.stderr)] == [0, 1, 2]
sys.exit(subprocess.run([sys.executable, "-c", {CHILD!r}]).returncode)
"""
APPLICATION = "from gapmes.service.serving import app; app()"


@pytest.mark.parametrize("code", [PARENT, APPLICATION], ids=["streams", "application"])
@pytest.mark.parametrize("where", ["<&- >&- 2>&-", "</dev/null 2>&-", "</dev/null >&-"])
def test_closed_streams_lead_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, where: str) -> None:
    monkeypatch.setenv("GAPMES_STORE", str(tmp_path))
    words = ["sh", "-c", f'exec "$0" "$@" {where}', sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
