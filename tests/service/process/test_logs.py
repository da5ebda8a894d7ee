"""The log: what libraries warn of has its line there, too."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator

import pytest

from gapmes.service.process.logs import OVER_LIMIT, SELDOM_S, configure


@pytest.fixture
def logged() -> Iterator[None]:
    """All warnings are events of the log, in JSON."""
    root = logging.getLogger()
    before = root.handlers[:], root.level
    try:
        with warnings.catch_warnings():
            configure("json")
            warnings.simplefilter("always")
            yield
    finally:
        root.handlers[:], root.level = before


@pytest.mark.usefixtures("logged")
def test_a_warning_of_a_library_is_a_line_of_the_log(capsys: pytest.CaptureFixture[str]) -> None:
    """Pillow warns of damaged EXIF: whoever sends such a photograph would break a log that is read as JSON."""
    warnings.warn("Corrupt EXIF data.\nExpecting to read 12 bytes. ", stacklevel=1)
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert (told["level"], told["message"]) == ("info", "UserWarning: Corrupt EXIF data. Expecting to read 12 bytes.")
    assert set(told) == {"time", "level", "logger", "message"}


@pytest.mark.usefixtures("logged")
def test_a_photograph_cannot_fill_the_log(capsys: pytest.CaptureFixture[str]) -> None:
    """EXIF of 250 kB warns of 20,000 entries, each in words of its own."""
    for tag in range(20):
        warnings.warn(f"Skipping tag {tag}", stacklevel=1)
    warnings.warn("another", stacklevel=1)
    lines = capsys.readouterr().err.splitlines()
    assert [json.loads(line)["message"] for line in lines] == ["UserWarning: Skipping tag 0", "UserWarning: another"]


@pytest.mark.usefixtures("logged")
def test_a_clock_that_is_set_back_silences_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("gapmes")
    for when in (1e9, 1e9 + SELDOM_S / 2, 1e9 - 3600, 1e9 - 3600 + SELDOM_S / 2, 1e9 - 1800):
        record = log.makeRecord("gapmes", logging.WARNING, __file__, 1, f"{OVER_LIMIT} at {when}", (), None)
        record.created = when
        logging.getLogger().handle(record)
    lines = capsys.readouterr().err.splitlines()
    assert [json.loads(line)["time"] for line in lines] == [1e9, 1e9 - 3600, 1e9 - 1800]
