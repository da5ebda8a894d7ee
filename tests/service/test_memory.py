"""What a reconstruction from two photographs needs at its peak, told by a process that does nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gapmes.service.shipped import sample_folder
from gapmes.service.splat import warm_up

MOST_BYTES = 400e6
PROGRAM = """
from gapmes.service.cli import main
try:
    main()
finally:
    with open("/proc/self/status") as file:
        print(next(line.split()[1] for line in file if line.startswith("VmHWM:")))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's /proc")
def test_two_views_fit_into_400_megabytes(tmp_path: Path) -> None:
    warm_up()  # compiling the kernels takes memory of its own, once
    arguments = ["reconstruct", str(sample_folder()), "-o", str(tmp_path / "scene.ply"), "--views", "0,1", "-q"]
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], check=True, capture_output=True, text=True, timeout=300
    )
    assert (tmp_path / "scene.ply").is_file()
    assert 1024 * int(found.stdout) < MOST_BYTES
