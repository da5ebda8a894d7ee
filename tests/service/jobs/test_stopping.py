"""A process that ends while the index cannot be written."""

from __future__ import annotations

import sqlite3
import threading
from contextlib import closing

import pytest
from job_place import Place


def test_stopping_ends_in_time_where_the_index_is_locked(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would wait for half a minute, and then keep its lease. What it computed is taken up by another."""
    monkeypatch.setattr("gapmes.service.jobs.table.PARTING_S", 0.05)
    monkeypatch.setattr("gapmes.service.scenes.database.BUSY_S", 3600.0)
    begun, going = threading.Event(), threading.Event()
    runner = place.runner(lambda *_: (begun.set(), going.wait(120)))
    place.submit()
    assert begun.wait(60)
    with closing(sqlite3.connect(place.root / "index.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        runner.stop(0.05)
    runner._lease.release()
    assert place.table.get("1").state == "running"
    place.runner(lambda *_: None)
    assert place.ended().state == "done"
    going.set()


def test_stopping_leaves_the_index_alone_where_all_jobs_have_ended(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that ends after many jobs has nothing to note of each."""
    runner = place.runner(lambda *_: None)
    place.submit()
    place.ended()
    noted: list[object] = []
    monkeypatch.setattr(place.table, "give_back", lambda *given: noted.append(given))
    runner.stop(60.0)
    assert noted == []
