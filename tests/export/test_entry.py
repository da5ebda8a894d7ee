"""`gapmes-export` without its extra: one line that says what to install."""

from __future__ import annotations

import sys

import pytest

from gapmes.export import entry


def test_without_torch_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith(("gapmes.export.", "gapmes.model"))]:
        if name != "gapmes.export.entry":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 1
    assert capsys.readouterr().err == "refused: gapmes-export needs torch: pip install 'gapmes[export]'\n"


def test_with_it_the_command_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["gapmes-export", "--help"])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 0
    assert "--checkpoint" in capsys.readouterr().out
