"""State changes of jobs in the store's database: one active job per scene, claimed by one process, ended once.

queued -> running -> done | failed | cancelled        queued -> cancelled        running -> queued (its process ended)

Every end is counted in the metrics once it is committed.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from sqlite3 import Connection
from typing import Any

from .. import metrics
from ..errors import ServiceBusy
from ..scenes.database import Database
from ..scenes.scene_index import UNSET_NS
from .reading import JobReader
from .rows import (
    Job,
    cancel_unwanted,
    end_job,
    found_job,
    requeue_job,
    running_job,
    tell,
    wait_for,
)

UNSET_S = UNSET_NS / 10**9
PARTING_S = 1.0  # of the about four seconds that a process has to end after its deadline
MAX_ATTEMPTS = 2  # after this many dead processes the job itself is taken to be the cause


class JobTable(JobReader):
    """Each method is one transaction, safe from any thread and process of the store."""

    def __init__(self, database: Database, *, most: int, keep_s: float, slots: Callable[[], int] = lambda: 0) -> None:
        """At most `most` jobs may wait beside those that fill the processes' `slots`. Rows of ended jobs are deleted
        after `keep_s` seconds."""
        super().__init__(database)
        self._most, self._slots = most, slots
        self._keep_s = keep_s

    def check_room(self) -> None:
        """Raises `ServiceBusy` if a new job would be refused."""
        self._check(sum(self.counts().values()))

    def join(self, scene_id: str, waits: str | None = None) -> Job | None:
        """Join the active job of the scene; None if there is none. It is kept from now on, or, if `waits` names a
        process, wanted for as long as a request of that process waits."""
        with self._database.write() as connection:
            return self._joined(connection, scene_id, waits)

    def submit(self, job_id: str, scene_id: str, waits: str | None = None) -> Job:
        """Queue a job whose inputs are spooled under `job_id`, or join the scene's active one, which has another id.
        `waits` as in `join`. Raises `ServiceBusy`."""
        with self._database.write() as connection:
            there = self._joined(connection, scene_id, waits)
            if there is not None:
                return there
            (active,) = connection.execute("SELECT count(*) FROM jobs WHERE state IN ('queued', 'running')").fetchone()
            self._check(active)
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, created) VALUES (?, ?, 'queued', ?, ?)",
                [job_id, scene_id, waits is None, time.time()],
            )
            wait_for(connection, job_id, waits)
            tell(connection, job_id, "state", {"state": "queued"})
            return found_job(connection, job_id)

    def already_done(self, scene_id: str) -> Job:
        """A job of a stored scene that is done from the start. One from an earlier request is reused during the first
        half of `keep_s`, so that repeated requests add no rows."""
        now, job_id = time.time(), uuid.uuid4().hex
        with self._database.write() as connection:
            self._forget(connection)
            last = connection.execute(
                "SELECT id FROM jobs WHERE scene_id = ? AND state = 'done' AND started IS NULL AND ended > ?",
                [scene_id, now - self._keep_s / 2],
            ).fetchone()
            if last is not None:
                return found_job(connection, last["id"])
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, created, ended) VALUES (?, ?, 'done', 1, ?, ?)",
                [job_id, scene_id, now, now],
            )
            tell(connection, job_id, "state", {"state": "done"})
            job = found_job(connection, job_id)
        metrics.JOBS.labels("done").inc()
        return job

    def claim(self, owner: str, *, waited_for: bool = False) -> Job | None:
        """Mark the oldest queued job, in order of insertion, as running for `owner`, and return it; None if there is
        none. With `waited_for` only jobs that a request waits for."""
        some = "state = 'queued'" + (" AND id IN (SELECT job_id FROM waits)" if waited_for else "")
        if not self._database.rows(f"SELECT 1 FROM jobs WHERE {some} LIMIT 1"):
            return None  # most polls find nothing, and need no write lock
        with self._database.write() as connection:
            rows = connection.execute(
                "UPDATE jobs SET state = 'running', owner = ?, started = ?, attempts = attempts + 1 WHERE id ="
                f" (SELECT id FROM jobs WHERE {some} ORDER BY rowid LIMIT 1) RETURNING id",
                [owner, time.time()],
            ).fetchall()
            if not rows:
                return None
            job = found_job(connection, rows[0]["id"])
            tell(connection, job.id, "state", {"state": "running", "attempt": job.attempts})
            return job

    def stage(self, job_id: str, owner: str, data: Mapping[str, Any]) -> bool:
        """Add a stage event; returns whether to go on: False if the job was cancelled or is no longer this owner's."""
        with self._database.write() as connection:
            row = running_job(connection, job_id, owner)
            if row is None or row["cancelled"]:
                return False
            tell(connection, job_id, "stage", data)
            return True

    def end(self, job_id: str, owner: str, state: str, problem: Mapping[str, Any] | None = None) -> bool:
        """Set the owner's running job to done or failed; returns False if it was no longer this owner's."""
        with self._database.write() as connection:
            self._forget(connection)
            if running_job(connection, job_id, owner) is None:
                return False
            end_job(connection, job_id, state, problem)
        metrics.JOBS.labels(state).inc()
        return True

    def end_cancelled(self, job_id: str, owner: str) -> bool:
        """End the owner's job as cancelled, or queue it again if somebody has joined it meanwhile. Returns whether it
        ended."""
        return self._stopped(job_id, owner, "somebody wants it again")

    def give_back(self, job_id: str, owner: str) -> bool:
        """Queue a job again that its owner will not finish, or end it if it was cancelled. Returns whether it ended.
        A process that ends waits no more than `PARTING_S` for the index."""
        return self._stopped(job_id, owner, "the process that computed it stopped", PARTING_S)

    def leave(self, job_id: str, process: str, *, goes_on: bool = False) -> bool:
        """A request of a process stops waiting. A job that nobody else wants is cancelled, unless it `goes_on`. Returns
        whether this ended it."""
        with self._database.write() as connection:
            one = "SELECT rowid FROM waits WHERE job_id = ? AND process = ? LIMIT 1"
            connection.execute(f"DELETE FROM waits WHERE rowid IN ({one})", [job_id, process])
            over = not goes_on and cancel_unwanted(connection, job_id, "the client went away")
        if over:
            metrics.JOBS.labels("cancelled").inc()
        return over

    def cancel(self, job_id: str) -> Job:
        """Cancel the job unless requests wait for the same scene.

        Raises `JobNotFound`.
        """
        with self._database.write() as connection:
            found_job(connection, job_id)
            connection.execute("UPDATE jobs SET kept = 0 WHERE id = ?", [job_id])
            over = cancel_unwanted(connection, job_id, "it was cancelled")
            job = found_job(connection, job_id)
        if over:
            metrics.JOBS.labels("cancelled").inc()
        return job

    def recover(self, gone: set[str], why: Mapping[str, Any]) -> set[str]:
        """Queue the running jobs of the processes `gone` again, or fail them with `why` after `MAX_ATTEMPTS`. Returns
        the ids of those that ended.

        Requests that waited in these processes are deleted. Their jobs go on, since the clients will ask again, but can
        be cancelled.
        """
        over: dict[str, str] = {}
        with self._database.write() as connection:
            connection.executemany("DELETE FROM waits WHERE process = ?", [[process] for process in gone])
            for row in connection.execute("SELECT * FROM jobs WHERE state = 'running'").fetchall():
                if row["owner"] not in gone:
                    continue
                if row["cancelled"]:
                    over[row["id"]] = "cancelled"
                elif row["attempts"] >= MAX_ATTEMPTS:
                    over[row["id"]] = "failed"
                else:
                    requeue_job(connection, row["id"], "the process that computed it ended unexpectedly")
            for job_id, state in over.items():
                end_job(connection, job_id, state, why if state == "failed" else None)
        for state in over.values():
            metrics.JOBS.labels(state).inc()
        return set(over)

    def forget(self) -> None:
        """Delete jobs that ended more than `keep_s` ago. Ends in the future, by a fast clock, are set to now."""
        now = time.time()
        if not self._database.rows(
            "SELECT 1 FROM jobs WHERE ended < ? OR ended > ? LIMIT 1", [now - self._keep_s, now]
        ):
            return
        with self._database.write() as connection:
            self._forget(connection)

    def use_room(self) -> None:
        """Checkpoint the write-ahead log into the tables, once a full disk has some room again."""
        self._database.empty_log()

    def _stopped(self, job_id: str, owner: str, why: str, patience_s: float | None = None) -> bool:
        """End the owner's job if it was cancelled, else queue it again, not counting the attempt; whether it ended."""
        with self._database.write(patience_s) as connection:
            row = running_job(connection, job_id, owner)
            if row is None:
                return False
            if not row["cancelled"]:
                requeue_job(connection, job_id, why, attempts=-1)
                return False
            end_job(connection, job_id, "cancelled", None)
        metrics.JOBS.labels("cancelled").inc()
        return True

    def _joined(self, connection: Connection, scene_id: str, waits: str | None) -> Job | None:
        rows = connection.execute(
            "UPDATE jobs SET kept = max(kept, ?), cancelled = 0"
            " WHERE scene_id = ? AND state IN ('queued', 'running') RETURNING id",
            [waits is None, scene_id],
        ).fetchall()
        if not rows:
            return None
        wait_for(connection, rows[0]["id"], waits)
        return found_job(connection, rows[0]["id"])

    def _forget(self, connection: Connection) -> None:
        now = time.time()
        if now > UNSET_S:
            connection.execute("UPDATE jobs SET ended = ? WHERE ended > ?", [now, now])
        old = [now - self._keep_s]
        connection.execute("DELETE FROM events WHERE job_id IN (SELECT id FROM jobs WHERE ended < ?)", old)
        connection.execute("DELETE FROM jobs WHERE ended < ?", old)

    def _check(self, active: int) -> None:
        most = self._most + self._slots()
        if active >= most:
            raise ServiceBusy(
                f"{active} reconstructions are running or waiting, the limit is {most}", cure="retry later"
            )
