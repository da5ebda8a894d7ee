"""A store's jobs, whose runners end with the test, and their table on its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from job_place import Place

from gapmes.service.jobs.table import JobTable
from gapmes.service.scenes.database import Database


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    place = Place(tmp_path)
    yield place
    for runner in place.runners:
        runner.stop(5.0)


@pytest.fixture
def table(tmp_path: Path) -> JobTable:
    return JobTable(Database(tmp_path / "index.sqlite"), most=5, keep_s=100.0)
