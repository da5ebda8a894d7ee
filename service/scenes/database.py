"""The store's SQLite file: scenes and jobs as tables that threads and processes share, one short write at a time."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from ..errors import GapmesError, StorageFull
from ..process.file_lock import exclusive

BUSY_S = 30.0  # that a write waits for another process's; each takes milliseconds
VERSION = 2
_ANEW = "move the file away: scenes are listed anew from their folders, its jobs are lost"
_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE)  # the second where a quota is

# A job is active while it is queued or running; a scene has one active job at most. A row of `waits` is a request of a
# process that waits for a job's answer.
_WAITS = """
CREATE TABLE IF NOT EXISTS waits (job_id TEXT NOT NULL, process TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS waits_job ON waits (job_id);
"""
_SCHEMA = f"""
CREATE TABLE IF NOT EXISTS scenes (
    id TEXT PRIMARY KEY, created_ns INTEGER NOT NULL, used_ns INTEGER NOT NULL, bytes INTEGER NOT NULL,
    summary TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS scenes_created ON scenes (created_ns);
CREATE INDEX IF NOT EXISTS scenes_used ON scenes (used_ns);
CREATE TABLE IF NOT EXISTS jobs (
    id TEXT PRIMARY KEY, scene_id TEXT NOT NULL, state TEXT NOT NULL, kept INTEGER NOT NULL,
    cancelled INTEGER NOT NULL DEFAULT 0, attempts INTEGER NOT NULL DEFAULT 0, owner TEXT, created REAL NOT NULL,
    started REAL, ended REAL, problem TEXT
);
CREATE UNIQUE INDEX IF NOT EXISTS jobs_active ON jobs (scene_id) WHERE state IN ('queued', 'running');
CREATE INDEX IF NOT EXISTS jobs_state ON jobs (state, created);
CREATE INDEX IF NOT EXISTS jobs_ended ON jobs (ended);
CREATE TABLE IF NOT EXISTS events (
    job_id TEXT NOT NULL, seq INTEGER NOT NULL, name TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (job_id, seq)
);
{_WAITS}
"""
_PROBES = (
    "scenes VALUES ('', 0, 0, 0, '')",
    "jobs (id, scene_id, state, kept, created) VALUES ('', '', '', 0, 0)",
    "events VALUES ('', 0, '', '')",
    "waits VALUES ('', '')",
)
# What a file of each version lacks. Version 1 counted the requests that wait in `jobs.waiting`: they ended with their
# processes.
_MISSING = {0: _SCHEMA, 1: f"{_WAITS} ALTER TABLE jobs DROP COLUMN waiting", VERSION: ""}


class Database:
    """Connections by thread to one file; with the write-ahead log readers never wait."""

    def __init__(self, path: Path) -> None:
        """Open or make the file, and give one of an earlier version what it lacks; one of this version is not written,
        so that what is on a full disk can be read. Raises `GapmesError` where a later version of the service has made
        it, or where it is no such file, damaged, or cannot be written."""
        self._path = path
        self._threads = threading.local()
        with exclusive(path.with_name(f"{path.name}.lock")):  # the change to the write-ahead log waits for nobody
            try:
                self._complete()
            except sqlite3.DatabaseError as error:
                raise GapmesError(
                    f"{path} cannot be used: {error}",
                    field="store",
                    cure=f"let this user write it, or {_ANEW}",
                ) from error

    def _complete(self) -> None:
        damage = self.rows("PRAGMA quick_check(1)")[0][0]
        if damage != "ok":
            raise sqlite3.DatabaseError(str(damage).strip())
        found = self.rows("PRAGMA user_version")[0][0]
        if found not in _MISSING:
            raise GapmesError(
                f"{self._path} has version {found}, this service reads versions 1 to {VERSION}",
                field="store",
                cure=f"use another store, or {_ANEW}",
            )
        if found != VERSION:
            with self.write() as connection:
                for statement in _MISSING[found].split(";"):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {VERSION}")

    def _connection(self) -> sqlite3.Connection:
        connection = getattr(self._threads, "connection", None)
        if connection is None:
            connection = sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None)
            connection.row_factory = sqlite3.Row
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")  # a power cut may cost the last writes, a crash none
            self._threads.connection = connection
        return connection

    @contextmanager
    def write(self) -> Iterator[sqlite3.Connection]:
        """A transaction that has the file to itself: all of the block, or nothing where it raises.

        Raises `StorageFull` where the disk is.
        """
        connection = self._connection()
        try:
            connection.execute("BEGIN IMMEDIATE")
            yield connection
            connection.execute("COMMIT")
        except BaseException as error:
            if connection.in_transaction:  # a full disk may have rolled it back already
                connection.execute("ROLLBACK")
            if isinstance(error, sqlite3.OperationalError) and error.sqlite_errorcode in _FULL:
                raise StorageFull(
                    "no space for the index", field="store", cure="delete scenes, or give it room"
                ) from error
            raise

    def writable(self) -> bool:
        """Whether a row could be added to every table, by a connection of its own, which knows nothing of the file yet:
        it is tried and taken back."""
        try:
            with closing(sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None)) as connection:
                connection.execute("BEGIN IMMEDIATE")
                for row in _PROBES:
                    connection.execute(f"INSERT INTO {row}")
                connection.execute("ROLLBACK")
        except sqlite3.DatabaseError:
            return False
        return True

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """What a query finds."""
        return self._connection().execute(statement, values).fetchall()
