"""Settings for the whole suite: continuous integration draws the same property-test examples in every run, and the
processes share the processors."""

from __future__ import annotations

import os

from hypothesis import settings

if "PYTEST_XDIST_WORKER" in os.environ:  # threads that wait for each other by spinning take the others' time
    os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")
