"""Settings for the whole suite: continuous integration draws the same property-test examples in every run, and the
processes share the processors."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

from gapmes.service.process.threads import available_threads

if "PYTEST_XDIST_WORKER" in os.environ:  # threads that wait for each other by spinning take the others' time
    os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One process more than processors, as some tests wait: for a browser, or for a command that begins."""
    return available_threads() + 1
