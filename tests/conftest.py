"""Settings for the whole suite: no property test is timed, continuous integration draws the same examples in every run,
and the processes share the processors."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

if "PYTEST_XDIST_WORKER" in os.environ:  # threads that wait for each other by spinning take the others' time
    os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile(
    "untimed",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=bool(os.environ.get("CI")),
)
settings.load_profile("untimed")
