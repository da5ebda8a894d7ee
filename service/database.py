"""The store's SQLite file: scenes and jobs as tables that threads and processes share, one short write at a time."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import GapmesError, StorageFull
from .file_lock import exclusive

BUSY_S = 30.0  # that a write waits for another process's; each takes milliseconds
VERSION = 2
_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE)  # the second where a quota is

# A job is active while it is queued or running; a scene has one active job at most. A row of `waits` is a request of a
# process that waits for a job's answer.
_SCHEMA = """
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
CREATE TABLE IF NOT EXISTS waits (job_id TEXT NOT NULL, process TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS waits_job ON waits (job_id);
CREATE TABLE IF NOT EXISTS events (
    job_id TEXT NOT NULL, seq INTEGER NOT NULL, name TEXT NOT NULL, data TEXT NOT NULL, PRIMARY KEY (job_id, seq)
);
"""


class Database:
    """Connections by thread to one file; with the write-ahead log readers never wait."""

    def __init__(self, path: Path) -> None:
        """Open or make the file; one that is there is not written. Raises `GapmesError` where another version of the
        service has made it."""
        self._path = path
        self._threads = threading.local()
        with exclusive(path.with_name(f"{path.name}.lock")):  # the change to the write-ahead log waits for nobody
            found = self.rows("PRAGMA user_version")[0][0]
            if found == 0:
                with self.write() as connection:
                    for statement in _SCHEMA.split(";"):
                        connection.execute(statement)
                    connection.execute(f"PRAGMA user_version = {VERSION}")
            elif found != VERSION:
                raise GapmesError(
                    f"{path} has version {found}, this service reads version {VERSION}",
                    field="store",
                    cure="use another store, or move the file away: scenes are listed anew from their folders",
                )

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

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """What a query finds."""
        return self._connection().execute(statement, values).fetchall()
