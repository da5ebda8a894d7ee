"""Progress on stderr: bars on a terminal, lines elsewhere."""

from __future__ import annotations

import re
import sys

import pytest
from rich.console import Console

from gapmes.service.progress import Stages
from gapmes.service.terminal import ProgressBars


def test_progress_is_drawn_on_a_terminal_and_written_elsewhere(capfd: pytest.CaptureFixture[str]) -> None:
    for terminal in (True, False):
        console = Console(file=sys.stderr, force_terminal=terminal, width=100, color_system=None)
        with ProgressBars(console) as bars, Stages(bars).stage("network", 4) as step:
            step(2)
        out, err = capfd.readouterr()
        assert out == ""
        assert re.search(r"network.* \d\.\d\d s", err)
        assert ("4/4" in err) == terminal
