"""The store's SQLite file: versions, whole transactions, a full disk, many who open it at once."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from gapmes.service.database import Database
from gapmes.service.errors import GapmesError, StorageFull


def test_a_file_of_another_version_is_refused(tmp_path: Path) -> None:
    with Database(tmp_path / "index.sqlite").write() as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(GapmesError, match="version 99, this service reads version 2"):
        Database(tmp_path / "index.sqlite")


def test_a_failed_transaction_leaves_nothing(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")

    def broken() -> None:
        with database.write() as connection:
            connection.execute("INSERT INTO scenes VALUES ('x', 1, 1, 1, '{}')")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken()
    assert database.rows("SELECT * FROM scenes") == []
    with database.write() as connection:
        connection.execute("INSERT INTO scenes VALUES ('x', 1, 1, 1, '{}')")
    assert len(database.rows("SELECT * FROM scenes")) == 1


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")
    database.rows("PRAGMA max_page_count = 20")

    def fill() -> None:
        with database.write() as connection:
            connection.execute("INSERT INTO scenes VALUES ('x', 1, 1, 1, ?)", ["y" * 200_000])

    with pytest.raises(StorageFull, match="no space for the index"):
        fill()
    assert database.rows("SELECT * FROM scenes") == []


def test_many_open_a_new_file_at_once(tmp_path: Path) -> None:
    failures = []

    def opened(path: Path) -> None:
        try:
            Database(path)
        except Exception as error:
            failures.append(error)

    for number in range(20):
        threads = [threading.Thread(target=opened, args=(tmp_path / str(number),)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert failures == []
