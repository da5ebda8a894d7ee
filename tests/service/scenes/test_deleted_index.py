"""An index that is deleted under many threads of several processes, all of which go on."""

from __future__ import annotations

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from gapmes.service.process.file_lock import exclusive
from gapmes.service.scenes.database import Database

THREADS, TIMES = 8, 30


def test_threads_that_find_it_gone_at_once_make_it_once(tmp_path: Path) -> None:
    """Each object stands for a process: they share nothing but the files."""
    path = tmp_path / "index.sqlite"
    databases = [Database(path) for _ in range(2)]
    together, made = threading.Barrier(THREADS), []
    for database in databases:
        database.fill = lambda: made.append(1)

    def used(number: int) -> None:
        database = databases[number % 2]
        for turn in range(TIMES):
            if together.wait(60) == 0:
                for file in tmp_path.glob("index.sqlite*"):
                    if not file.name.endswith(".lock"):
                        file.unlink()
            together.wait(60)
            assert database.rows("SELECT * FROM jobs") == []
            with database.write() as connection:
                connection.execute(f"INSERT INTO scenes VALUES ('{turn}-{number}', 1, 1, 1, '')")

    with ThreadPoolExecutor(THREADS) as threads:
        for each in [threads.submit(used, number) for number in range(THREADS)]:
            each.result()
    assert len(made) == TIMES
    assert len(Database(path).rows("SELECT * FROM scenes")) == THREADS


def test_who_finds_a_file_that_another_process_is_making_waits_for_it(tmp_path: Path) -> None:
    """It does not begin to make it, too, which SQLite refuses at once."""
    path = tmp_path / "index.sqlite"
    database = Database(path)
    for file in tmp_path.glob("index.sqlite*"):
        file.unlink()
    with ThreadPoolExecutor(1) as threads:
        with exclusive(tmp_path / "index.sqlite.lock"), closing(sqlite3.connect(path, isolation_level=None)) as maker:
            maker.execute("BEGIN IMMEDIATE")
            found = threads.submit(database.rows, "SELECT * FROM jobs")
            with pytest.raises(TimeoutError):
                found.result(0.3)
            maker.execute("COMMIT")
        assert found.result(60) == []
    for each in (database, Database(path)):
        assert each.rows("PRAGMA journal_mode")[0][0] == "wal"
