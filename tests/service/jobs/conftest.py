"""A store's jobs, whose runners end with the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from job_place import Place


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    place = Place(tmp_path)
    yield place
    for runner in place.runners:
        runner.stop(5.0)
