"""Warnings on a terminal name their view once."""

from __future__ import annotations

import pytest

from gapmes.service.commands.summary import warning_line


@pytest.mark.parametrize(
    ("warning", "line"),
    [
        ({"message": "far is wide"}, "warning: far is wide"),
        (
            {"index": 0, "message": "EXIF orientation 6 is not applied"},
            "warning: view 0: EXIF orientation 6 is not applied",
        ),
        (
            {"index": 2, "message": "view 2 hardly matches any of the others"},
            "warning: view 2 hardly matches any of the others",
        ),
        ({"index": 1, "message": "photographs 0 and 1 are the same"}, "warning: photographs 0 and 1 are the same"),
        ({"index": 4, "message": "the photograph of 96 x 72 px"}, "warning: view 4: the photograph of 96 x 72 px"),
    ],
)
def test_a_warning_names_its_view_once(warning: dict, line: str) -> None:
    assert warning_line(warning) == line
