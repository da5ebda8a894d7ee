"""Lines of a reconstruction on a terminal: warnings name their view once, and fading says how much it has changed."""

from __future__ import annotations

import pytest

from gapmes.service.commands.summary import fading_line, warning_line


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


@pytest.mark.parametrize(
    ("passes", "line"),
    [
        (0, "fading: off"),
        (1, "fading in 1 pass: 1,234 Gaussians lost"),
        (4, "fading in 4 passes: 1,234 Gaussians lost"),
    ],
)
def test_fading_says_how_much_it_has_changed(passes: int, line: str) -> None:
    told = fading_line({"fading": {"passes": passes, "halved": 1234, "gone": 5, "recoloured": 2 / 255}})
    assert told.startswith(line)
    if passes:
        assert told.endswith("5 are no longer drawn, and colours moved by 2.0 of 255 on average")
