"""Switches in the environment: the settings' own and the demonstration's are read by one rule."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runs import run

from gapmes.service import demo
from gapmes.service.errors import InputError
from gapmes.service.settings import Settings, checked_settings

TABLE = Path(__file__).parents[2] / "docs" / "settings.md"
ON, OFF = ("1", "true", "True", "YES", "on"), ("0", "false", "False", "no", "OFF", "")
NEITHER = ("2", "maybe", " 1", "10", "y", "n", "t", "f")
NEED = "1, true, yes or on, or 0, false, no or off"
SWITCHES = [name for name, field in Settings.model_fields.items() if field.annotation is bool]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each demonstration would leave its service; none is made."""
    found: list[bool] = []

    def run_demo(*_: object, keep: bool) -> demo.DemoResult:
        found.append(keep)
        raise InputError("enough")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr(demo, "run_demo", run_demo)
    return found


@pytest.mark.parametrize("name", SWITCHES)
def test_settings_and_the_demonstration_read_the_same_words(
    monkeypatch: pytest.MonkeyPatch, kept: list[bool], name: str
) -> None:
    for word in (*ON, *OFF):
        monkeypatch.setenv(f"GAPMES_{name.upper()}", word)
        monkeypatch.setenv("KEEP", word)
        assert getattr(checked_settings(), name) == (word in ON), word
        assert run("demo") == 1
        assert kept.pop() == (word in ON), word


@pytest.mark.parametrize("word", NEITHER)
def test_another_word_is_refused_with_those_that_are_read(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kept: list[bool], word: str
) -> None:
    for name in SWITCHES:
        monkeypatch.setenv(f"GAPMES_{name.upper()}", word)
        with pytest.raises(InputError, match=f"Input should be {NEED}, got {word!r}") as caught:
            checked_settings()
        assert caught.value.field == f"GAPMES_{name.upper()}"
        monkeypatch.delenv(f"GAPMES_{name.upper()}")
    monkeypatch.setenv("KEEP", word)
    assert run("demo") == 1
    assert kept == []
    assert capsys.readouterr().err == f"error: KEEP: is {word!r}, need {NEED}\n"


def test_the_words_are_documented() -> None:
    said = " ".join(TABLE.read_text(encoding="utf-8").split())
    assert "A switch is `1`, `true`, `yes` or `on`, or `0`, `false`, `no` or `off`" in said
