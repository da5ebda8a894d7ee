"""The log: what libraries warn of has its line there, too."""

from __future__ import annotations

import json
import logging
import warnings

import pytest

from gapmes.service.process.logs import configure


def test_a_warning_of_a_library_is_a_line_of_the_log(capsys: pytest.CaptureFixture[str]) -> None:
    """Pillow warns of damaged EXIF: whoever sends such a photograph would break a log that is read as JSON."""
    root = logging.getLogger()
    before = root.handlers[:], root.level
    try:
        with warnings.catch_warnings():
            configure("json")
            warnings.simplefilter("always")
            warnings.warn("Corrupt EXIF data.\nExpecting to read 12 bytes. ", stacklevel=1)
    finally:
        root.handlers[:], root.level = before
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert (told["level"], told["message"]) == ("info", "UserWarning: Corrupt EXIF data. Expecting to read 12 bytes.")
