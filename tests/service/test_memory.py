"""What a reconstruction from two photographs needs at its peak, measured by a process that does nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gapmes.service.shipped import sample_folder
from gapmes.service.splat import warm_up

MOST_BYTES = 400e6


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the unit of ru_maxrss is Linux's")
def test_two_views_fit_into_400_megabytes(tmp_path: Path) -> None:
    warm_up()  # compiling the kernels takes memory of its own, once
    program = "from gapmes.service.cli import main; main()"
    arguments = ["reconstruct", str(sample_folder()), "-o", str(tmp_path / "scene.ply"), "--views", "0,1", "-q"]
    process = subprocess.Popen([sys.executable, "-c", program, *arguments])
    _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert (tmp_path / "scene.ply").is_file()
    assert 1024 * usage.ru_maxrss < MOST_BYTES  # measured 348 MB
