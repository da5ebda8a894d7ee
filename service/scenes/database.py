"""The store's SQLite file: tables of scenes and jobs, shared by threads and processes in short transactions."""

from __future__ import annotations

import logging
import os
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import GapmesError, ServiceBusy, StorageFull
from ..process.disk import NO_FILE, made_again, no_further_file, private_folder
from ..process.file_lock import exclusive

BUSY_S = 30.0  # that a write waits for the lock of another; the service's own writes take milliseconds
FILES = 3  # that a connection opens: the database, its log and their index
PROBE_S = 2.0  # the same for `writable`, which a health check waits for
VERSION = 2
_log = logging.getLogger("gapmes")
_ANEW = "move the file away: scenes are listed anew from their folders, its jobs are lost"
_KIND = 0xFF  # bits of an extended error code that hold the primary one
_FULL = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE)  # the second for a quota

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
# Statements that bring a file of each version, a new one with the tables of `_SCHEMA`, to `VERSION`. Version 1 counted
# waiting requests in `jobs.waiting`; these ended with their processes.
_MISSING = {0: "", 1: f"{_WAITS} ALTER TABLE jobs DROP COLUMN waiting", VERSION: ""}


class Database:
    """One connection per thread to one file in WAL mode, in which readers never wait."""

    def __init__(self, path: Path, fill: Callable[[Database], object] = lambda _: None) -> None:
        """Open or create the file and migrate one of an earlier version. A file of this version is not written, so that
        a store on a full disk can be read. `fill` is called for a new file, also where it was deleted under the
        service, before anybody else can read it. Raises `GapmesError` for a file of a later version, and for one that
        is not a database, is damaged or cannot be written."""
        self._path = path
        self._threads = threading.local()
        self.fill: Callable[[], object] = lambda: fill(self)
        with self._alone():
            try:
                self._made(checked=True)
            except sqlite3.DatabaseError as error:
                raise GapmesError(
                    f"{path} cannot be used: {error}",
                    field="store",
                    cure=f"let this user write it, or {_ANEW}",
                ) from error

    def _alone(self) -> AbstractContextManager[None]:
        """Only one process opens the file meanwhile: switching to WAL mode does not wait for locks."""
        return exclusive(self._path.with_name(f"{self._path.name}.lock"))

    def _complete(self) -> bool:
        """Bring the file to `VERSION`, which a new one has once it is filled; returns whether it was new. Raises
        `GapmesError` for a later version."""
        found = self.rows("PRAGMA user_version")[0][0]
        if found not in _MISSING:
            raise GapmesError(
                f"{self._path} has version {found}, this service reads versions 1 to {VERSION}",
                field="store",
                cure=f"use another store, or {_ANEW}",
            )
        if found == 0:
            self._execute(_SCHEMA)
            self.fill()
        if found != VERSION:
            self._execute(f"{_MISSING[found]}; PRAGMA user_version = {VERSION}")
        return found == 0

    def _execute(self, statements: str) -> None:
        """In one transaction."""
        with self.write() as connection:
            for statement in statements.split(";"):
                connection.execute(statement)

    def ensure_there(self) -> None:
        """Make the file, and its folder, anew where somebody has deleted them. Raises `ServiceBusy` if that fails."""
        if _identity(self._path) is None:
            self._connection()

    def _connection(self) -> sqlite3.Connection:
        """The thread's connection to the file that is there now: a deleted one would take writes that nobody reads."""
        connection, file = getattr(self._threads, "known", (None, None))
        there = _identity(self._path)
        if connection is not None and (connection.in_transaction or self._is_making() or file == there is not None):
            return connection
        if there is None or not self._connect().execute("PRAGMA user_version").fetchone()[0]:
            self._disconnect()
            self._make_anew()
        return self._threads.known[0]

    def _is_making(self) -> bool:
        """Whether this thread makes the file anew, and must not begin again where that is deleted meanwhile."""
        return getattr(self._threads, "making", False)

    def _connect(self, *, switching: bool = False) -> sqlite3.Connection:
        """A new connection for this thread, in the place of an earlier one; `switching` the file to WAL mode, in which
        it stays. Only who is `_alone` may do that: it does not wait for another that does."""
        self._disconnect()
        connection = self._opened(switching)
        self._threads.known = connection, _identity(self._path)
        return connection

    def _disconnect(self) -> None:
        earlier, _ = getattr(self._threads, "known", (None, None))
        self._threads.known = None, None
        if earlier is not None:
            earlier.close()

    def _make_anew(self) -> None:
        """Make the file where it is missing or empty, unless another thread or process does meanwhile."""
        with made_again(self._path.parent):
            private_folder(self._path.parent)
            with self._alone():
                if _identity(self._path) is None:
                    for end in ("-wal", "-shm"):  # of the deleted file
                        self._path.with_name(f"{self._path.name}{end}").unlink(missing_ok=True)
                new = self._made()
        if new:
            _log.warning("%s was deleted under the service: it is made anew, and its jobs are lost", self._path)

    def _made(self, *, checked: bool = False) -> bool:
        """`_complete` on a new connection, which this thread uses for all until then, and no more if that fails."""
        with ExitStack() as failed:
            self._connect(switching=True)
            failed.callback(self._disconnect)
            self._threads.making = True
            try:
                if checked and (damage := self.rows("PRAGMA quick_check(1)")[0][0]) != "ok":
                    raise sqlite3.DatabaseError(str(damage).strip())
                new = self._complete()
            finally:
                self._threads.making = False
            failed.pop_all()
        return new

    def _opened(self, switching: bool) -> sqlite3.Connection:
        """A new connection. Raises `ServiceBusy` if the process has too many open files."""
        with ExitStack() as failed:
            try:
                connection = sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None)
                failed.callback(connection.close)
                connection.row_factory = sqlite3.Row
                if switching:
                    connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = NORMAL")  # a power cut may cost the last writes, a crash none
            except sqlite3.OperationalError as error:
                if self._lacks_files(error):
                    raise no_further_file() from error
                raise
            failed.pop_all()
        return connection

    @staticmethod
    def _lacks_files(error: sqlite3.DatabaseError) -> bool:
        """Whether it may be that the process has as many open files as it may have. Others are opened to find out: a
        file of the database that is closed again would lose the locks that this process has on it."""
        if error.sqlite_errorcode & _KIND != sqlite3.SQLITE_CANTOPEN:
            return False
        with ExitStack() as opened:
            try:
                for _ in range(FILES):
                    opened.callback(os.close, os.open(os.devnull, os.O_RDONLY))
            except OSError as cause:
                return cause.errno in NO_FILE
        return False

    @contextmanager
    def write(self, patience_s: float | None = None) -> Iterator[sqlite3.Connection]:
        """A write transaction around the block: committed at its end, rolled back if it raises.

        Raises `StorageFull` if the disk is full, after truncating the write-ahead log, and `ServiceBusy` if another
        program holds the lock for `patience_s`, by default `BUSY_S`.
        """
        connection = self._connection()
        patience_s = BUSY_S if patience_s is None else patience_s
        try:
            _begin(connection, patience_s)
            yield connection
            connection.execute("COMMIT")
        except BaseException as error:
            if connection.in_transaction:  # a full disk may have rolled it back already
                connection.execute("ROLLBACK")
            if isinstance(error, sqlite3.OperationalError) and error.sqlite_errorcode in _FULL:
                self.empty_log()
                raise StorageFull(
                    "no space for the index", field="store", cure="delete scenes, or give it room"
                ) from error
            if _is_locked(error):
                raise _locked(patience_s) from error
            raise

    def empty_log(self) -> None:
        """Checkpoint and truncate the write-ahead log, which otherwise grows to 4 MB before it is reused. Nothing
        happens while somebody reads, or if the tables find no room to grow."""
        with suppress(sqlite3.OperationalError), closing(sqlite3.connect(self._path, timeout=0)) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def writable(self) -> bool:
        """Whether a row can be inserted into every table: tried on a new connection, without cached pages, and rolled
        back. Raises `ServiceBusy` if another program holds the lock for `PROBE_S`, or no further file may be
        opened."""
        try:
            with closing(sqlite3.connect(self._path, timeout=PROBE_S, isolation_level=None)) as connection:
                connection.execute("BEGIN IMMEDIATE")
                for row in _PROBES:
                    connection.execute(f"INSERT INTO {row}")
                connection.execute("ROLLBACK")
        except sqlite3.DatabaseError as error:
            if _is_locked(error):
                raise _locked(PROBE_S) from error
            if self._lacks_files(error):
                raise no_further_file() from error
            return False
        return True

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """The rows of a query."""
        return self._connection().execute(statement, values).fetchall()


def _identity(path: Path) -> tuple[int, int] | None:
    """Of the file at the path, None without one. It holds while a connection keeps the file open."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return status.st_dev, status.st_ino


def _begin(connection: sqlite3.Connection, patience_s: float) -> None:
    """Begin to write; only this statement waits as long as that for the lock of another."""
    connection.execute(f"PRAGMA busy_timeout = {round(1000 * patience_s)}")
    try:
        connection.execute("BEGIN IMMEDIATE")
    finally:
        connection.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_S)}")


def _is_locked(error: BaseException) -> bool:
    return isinstance(error, sqlite3.OperationalError) and error.sqlite_errorcode & _KIND == sqlite3.SQLITE_BUSY


def _locked(seconds: float) -> ServiceBusy:
    return ServiceBusy(f"another program has locked the index for {seconds:g} s", field="store", cure="retry later")
