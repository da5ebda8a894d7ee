"""The lists of views that the commands take."""

from __future__ import annotations

import pytest

from gapmes.service.commands.selection import view_indices, view_specs
from gapmes.service.errors import ViewError


def test_views_on_the_command_line() -> None:
    assert view_indices("4, 8", 9) == [4, 8]
    assert view_specs("5,6.5,5") == ["5", "6.5"]
    assert view_specs("5, 6.5,5", repeated=True) == ["5", "6.5", "5"]
    for text in ("", "1,,2", "-1", "1.5", "٣"):
        with pytest.raises(ViewError):
            view_indices(text, 9)
    with pytest.raises(ViewError):
        view_specs("1,,2")
