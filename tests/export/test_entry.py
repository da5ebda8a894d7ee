"""`gapmes-export` and the training without their extra: one line names the packages to install."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gapmes.export import entry


@pytest.mark.parametrize(
    ("command", "run"),
    [
        ("gapmes-export", "from gapmes.export.entry import main; main()"),
        ("gapmes.model.training", "import runpy; runpy.run_module('gapmes.model.training', run_name='__main__')"),
    ],
)
def test_without_torch_it_says_what_to_install(command: str, run: str) -> None:
    """In a separate process: unloading a package here would leave other tests with two copies of its modules."""
    without = f"import sys; sys.modules['torch'] = None; {run}"
    ended = subprocess.run([sys.executable, "-c", without], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == f"refused: {command} needs torch: pip install 'gapmes[export]'\n"


OUTDATED = """
import sys, types
sys.modules["safetensors"] = types.ModuleType("safetensors")
from gapmes.export.entry import main
main()
"""


def test_another_version_of_a_package_is_named() -> None:
    ended = subprocess.run([sys.executable, "-c", OUTDATED], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith("refused: gapmes-export cannot use the installed safetensors (cannot import name ")
    assert ended.stderr.endswith("): pip install --upgrade 'gapmes[export]'\n")
    assert ended.stderr.count("\n") == 1


def test_with_it_the_command_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["gapmes-export", "--help"])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 0
    assert "--checkpoint" in capsys.readouterr().out
