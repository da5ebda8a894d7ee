"""Time the first picture of a process: with an empty cache of compiled loops, and with the one that it leaves."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

# Imports are not timed: reading numba's files takes as long as the disk does.
CHILD = """
import time
import numpy as np
from gapmes.service import Camera, Gaussians
from gapmes.service.splat import render
camera = Camera.make(64, 64, 64.0, 64.0, 32.0, 32.0, np.eye(4))
one = Gaussians.make([[0, 0, 2]], [[0.1, 0.2, 0.3]], [[1, 0, 0, 0]], [0.9], np.ones((1, 1, 3)))
start = time.perf_counter()
render(one, camera)
print(time.perf_counter() - start)
"""


def first_and_later() -> tuple[float, float]:
    """Seconds of the first call of `render` in two processes, one after the other, that share an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        runs = [
            subprocess.run([sys.executable, "-c", CHILD], env=environment, check=True, capture_output=True, text=True)
            for _ in range(2)
        ]
    first, later = (float(run.stdout) for run in runs)
    return first, later
