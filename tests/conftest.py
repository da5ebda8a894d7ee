"""Settings for the whole suite: no property test is timed, continuous integration draws the same examples in every run,
and the processes share the processors."""

from __future__ import annotations

import os

import pytest
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


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """For `-n auto` one process more than processors, as some wait for processes of their own, or for a graph that
    another makes; None, which leaves it to xdist, where its variable says how many."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    from gapmes.service.process.threads import available_threads  # not before the threads are limited

    return available_threads() + 1
