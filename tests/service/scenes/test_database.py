"""The store's SQLite file: versions, complete transactions, a full disk, concurrent opening."""

from __future__ import annotations

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from full_disk import full_disk

from gapmes.service.errors import GapmesError, ServiceBusy, StorageFull
from gapmes.service.jobs.table import JobTable
from gapmes.service.scenes import database as database_module
from gapmes.service.scenes import scene_index as scene_index_module
from gapmes.service.scenes.database import Database
from gapmes.service.scenes.scene_index import Indexed, SceneIndex

ROOM = 150_000  # bytes of a file: for the tables, and for some writes to them

# Version 1, with a job that is kept, one whose request waits, one that runs, and one that is done.
VERSION_1 = """
CREATE TABLE scenes (
    id TEXT PRIMARY KEY, created_ns INTEGER NOT NULL, used_ns INTEGER NOT NULL, bytes INTEGER NOT NULL,
    summary TEXT NOT NULL
);
CREATE INDEX scenes_created ON scenes (created_ns);
CREATE INDEX scenes_used ON scenes (used_ns);
CREATE TABLE jobs (
    id TEXT PRIMARY KEY, scene_id TEXT NOT NULL, state TEXT NOT NULL, kept INTEGER NOT NULL, waiting INTEGER NOT NULL,
    cancelled INTEGER NOT NULL DEFAULT 0, attempts INTEGER NOT NULL DEFAULT 0, owner TEXT, created REAL NOT NULL,
    started REAL, ended REAL, problem TEXT
);
CREATE UNIQUE INDEX jobs_active ON jobs (scene_id) WHERE state IN ('queued', 'running');
CREATE INDEX jobs_state ON jobs (state, created);
CREATE INDEX jobs_ended ON jobs (ended);
CREATE TABLE events (
    job_id TEXT NOT NULL, seq INTEGER NOT NULL, name TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (job_id, seq)
);
INSERT INTO scenes VALUES ('s', 1, 1, 1, '{}');
INSERT INTO jobs VALUES ('kept', 'a', 'queued', 1, 0, 0, 0, NULL, 1.0, NULL, NULL, NULL);
INSERT INTO jobs VALUES ('waited', 'b', 'queued', 0, 1, 0, 0, NULL, 2.0, NULL, NULL, NULL);
INSERT INTO jobs VALUES ('running', 'c', 'running', 0, 2, 0, 1, 'dead', 3.0, 4.0, NULL, NULL);
INSERT INTO jobs VALUES ('done', 'd', 'done', 1, 0, 0, 1, 'dead', 5.0, 6.0, 9e9, NULL);
INSERT INTO events VALUES ('kept', 1, 'state', '{"state": "queued"}');
PRAGMA user_version = 1;
"""


def test_a_file_of_another_version_is_refused(tmp_path: Path) -> None:
    with Database(tmp_path / "index.sqlite").write() as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(GapmesError, match="version 99, this service reads versions 1 to 2"):
        Database(tmp_path / "index.sqlite")


def test_jobs_of_a_file_of_version_1_go_on(tmp_path: Path) -> None:
    path = tmp_path / "index.sqlite"
    with sqlite3.connect(path) as connection:
        connection.executescript(VERSION_1)
    connection.close()
    for _ in range(2):  # the second time it is of this version
        database = Database(path)
        table = JobTable(database, most=9, keep_s=1e9)
        assert database.rows("PRAGMA user_version")[0][0] == 2
        assert len(database.rows("SELECT * FROM scenes")) == 1
        assert table.unfinished() == {"kept", "waited", "running"}
    assert table.get("done").state == "done"
    assert [event.data for event in table.events("kept")] == [{"state": "queued"}]
    assert table.processes() == {"dead"}
    assert table.recover({"dead"}, {}) == set()
    assert [table.claim("me").id for _ in range(3)] == ["kept", "waited", "running"]
    assert table.stage("waited", "me", {"stage": "x"})  # nobody has cancelled it
    assert table.join("b", "me").waiting == 1
    columns = [
        {row["name"] for row in Database(file).rows("PRAGMA table_info(jobs)")} for file in (path, tmp_path / "new")
    ]
    assert columns[0] == columns[1]


def test_what_is_no_such_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "index.sqlite").write_bytes(b"something else" * 1000)
    with pytest.raises(GapmesError, match="cannot be used: file is not a database") as caught:
        Database(tmp_path / "index.sqlite")
    assert caught.value.cure is not None


def damage(path: Path) -> None:
    """Overwrite all but the first page."""
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xff" * (path.stat().st_size - 4096))


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "index.sqlite"
    Database(path)
    damage(path)
    with pytest.raises(GapmesError, match=r"index\.sqlite cannot be used: ") as caught:
        Database(path)
    assert "move the file away" in str(caught.value.cure)


def test_a_file_that_is_damaged_meanwhile_is_not_writable(tmp_path: Path) -> None:
    """Also where what this process has read of it is as it was."""
    path = tmp_path / "index.sqlite"
    database = Database(path)
    database.rows("SELECT * FROM scenes")
    assert database.writable()
    assert database.rows("SELECT * FROM scenes") == []
    damage(path)
    assert not database.writable()


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


def test_the_log_of_writes_does_not_fill_the_disk_for_good(tmp_path: Path) -> None:
    """Each write makes it longer, and it is the disk that ends that: then there is room again at once."""
    database, refused = Database(tmp_path / "index.sqlite"), 0
    with full_disk(ROOM):
        for number in range(200):
            try:
                mark(database, number)
            except StorageFull:
                refused += 1
                mark(database, number)
    assert 0 < refused < 50
    assert database.rows("SELECT id FROM scenes")[0]["id"] == "199"


def mark(database: Database, number: int) -> None:
    with database.write() as connection:
        connection.execute("DELETE FROM scenes")
        connection.execute("INSERT INTO scenes VALUES (?, 1, 1, 1, '{}')", [str(number)])


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


def test_who_meets_a_locked_file_may_try_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Locked by a program that is none of the service's, such as a backup: reading goes on."""
    monkeypatch.setattr(database_module, "BUSY_S", 0.05)
    database = Database(tmp_path / "index.sqlite")
    index = SceneIndex(database)
    index.add([Indexed("s", 1, 1, 1, {})])
    with closing(sqlite3.connect(tmp_path / "index.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(ServiceBusy, match=r"locked the index for 0\.05 s"):
            index.remove(["s"])
        monkeypatch.setattr(database_module, "BUSY_S", 600.0)  # too long for who reads, or asks whether all is ready
        monkeypatch.setattr(scene_index_module, "NOTE_S", 0.02)
        index.used("s")
        assert [row.used_ns for row in index.page(1)] == [1]
        monkeypatch.setattr(database_module, "PROBE_S", 0.02)
        with pytest.raises(ServiceBusy, match=r"locked the index for 0\.02 s"):
            database.writable()
    assert index.remove(["s"]) == 1


def test_an_index_that_is_a_folder_is_no_busy_service(tmp_path: Path) -> None:
    (tmp_path / "index.sqlite").mkdir()
    with pytest.raises(GapmesError, match="cannot be used") as caught:
        Database(tmp_path / "index.sqlite")
    assert not isinstance(caught.value, ServiceBusy)


@pytest.mark.parametrize("deleted", ["index.sqlite", "index.sqlite*"])
def test_a_deleted_file_is_made_anew_for_every_thread(tmp_path: Path, deleted: str) -> None:
    """A connection to the deleted one would take writes that no other thread, and no later process, ever reads."""
    add = "INSERT INTO scenes VALUES ('x', 1, 1, 1, '{}')"
    database = Database(tmp_path / "index.sqlite")
    told: list[str] = []
    database.fill = lambda: told.append("anew")
    with ThreadPoolExecutor(1) as other:
        with database.write() as connection:
            connection.execute(add)
        assert len(other.submit(database.rows, "SELECT * FROM scenes").result()) == 1
        for path in tmp_path.glob(deleted):
            path.unlink()
        assert database.rows("SELECT * FROM scenes") == []
        with database.write() as connection:
            connection.execute(add.replace("x", "y"))
        for rows in (
            database.rows("SELECT * FROM scenes"),
            other.submit(database.rows, "SELECT * FROM scenes").result(),
        ):
            assert [row["id"] for row in rows] == ["y"]
        assert database.writable()
    assert told == ["anew"]
    assert [row["id"] for row in Database(tmp_path / "index.sqlite").rows("SELECT * FROM scenes")] == ["y"]


def test_an_empty_file_that_another_process_has_just_made_is_completed(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")
    for path in tmp_path.glob("index.sqlite*"):
        path.unlink()
    (tmp_path / "index.sqlite").touch()
    assert database.rows("SELECT * FROM scenes") == []


def test_a_write_that_has_begun_ends_where_it_began(tmp_path: Path) -> None:
    database = Database(tmp_path / "index.sqlite")
    with database.write() as connection:
        connection.execute("INSERT INTO scenes VALUES ('x', 1, 1, 1, '{}')")
        for path in tmp_path.glob("index.sqlite*"):
            path.unlink()
        assert len(database.rows("SELECT * FROM scenes")) == 1
    assert database.rows("SELECT * FROM scenes") == []
