"""Jobs and their events in the store's database: submitted once per scene, claimed by one process, ended once.

queued -> running -> done | failed | cancelled        queued -> cancelled        running -> queued (its process ended)

Every end is counted, once it is written.
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
MAX_ATTEMPTS = 2  # a job whose process died is tried once more; then it is taken for the reason


class JobTable(JobReader):
    """All of it is safe for many processes on one store."""

    def __init__(self, database: Database, *, most: int, keep_s: float, slots: Callable[[], int] = lambda: 0) -> None:
        """`most` active jobs beside as many as the processes have `slots` for; ended ones are forgotten after `keep_s`
        seconds."""
        super().__init__(database)
        self._most, self._slots = most, slots
        self._keep_s = keep_s

    def check_room(self) -> None:
        """Raises `ServiceBusy` where no further job would be taken."""
        self._check(sum(self.counts().values()))

    def join(self, scene_id: str, waits: str | None = None) -> Job | None:
        """Take part in the active job of the scene, if there is one: for good, or with a request of the process `waits`
        for as long as that waits."""
        with self._database.write() as connection:
            return self._joined(connection, scene_id, waits)

    def submit(self, job_id: str, scene_id: str, waits: str | None = None) -> Job:
        """Queue a job whose inputs are spooled under `job_id`, or take part in the scene's active one: the answer's id
        tells which. `waits` as in `join`. Raises `ServiceBusy`."""
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
        """A job of a stored scene that ended when it was asked for: one from before, while that is remembered for long
        enough, so that asking again and again adds none."""
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
        """The queued job that was asked for first, as the rows tell and no clock, running from now on and this owner's;
        with `waited_for` one whose answer a request waits for."""
        some = "state = 'queued'" + (" AND id IN (SELECT job_id FROM waits)" if waited_for else "")
        if not self._database.rows(f"SELECT 1 FROM jobs WHERE {some} LIMIT 1"):
            return None  # most looks find nothing, and need not write
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
        """Note a step of the work; returns whether it should go on: it is this owner's, and somebody wants it."""
        with self._database.write() as connection:
            row = running_job(connection, job_id, owner)
            if row is None or row["cancelled"]:
                return False
            tell(connection, job_id, "stage", data)
            return True

    def end(self, job_id: str, owner: str, state: str, problem: Mapping[str, Any] | None = None) -> bool:
        """The owner's job is done or failed; returns whether it was the owner's still."""
        with self._database.write() as connection:
            self._forget(connection)
            if running_job(connection, job_id, owner) is None:
                return False
            end_job(connection, job_id, state, problem)
        metrics.JOBS.labels(state).inc()
        return True

    def end_cancelled(self, job_id: str, owner: str) -> bool:
        """The owner's job ended because nobody wanted it; it begins anew where somebody does by now. Returns whether it
        is over."""
        return self._stopped(job_id, owner, "somebody wants it again")

    def give_back(self, job_id: str, owner: str) -> bool:
        """Queue a job again that its owner will not finish. One that was cancelled ends. Returns whether it is over by
        this."""
        return self._stopped(job_id, owner, "the process that computed it stopped")

    def leave(self, job_id: str, process: str, *, goes_on: bool = False) -> bool:
        """A request of a process does not wait any more; a job that nobody wants is cancelled, unless it `goes_on`.
        Returns whether that ended it."""
        with self._database.write() as connection:
            one = "SELECT rowid FROM waits WHERE job_id = ? AND process = ? LIMIT 1"
            connection.execute(f"DELETE FROM waits WHERE rowid IN ({one})", [job_id, process])
            over = not goes_on and cancel_unwanted(connection, job_id, "the client went away")
        if over:
            metrics.JOBS.labels("cancelled").inc()
        return over

    def cancel(self, job_id: str) -> Job:
        """Nobody asks for the job any more; requests that wait for the same scene keep it going.

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
        """Queue the running jobs of processes that are gone again, or fail them with `why` after the last attempt.
        Returns the ids of those that are over.

        Requests that waited there are forgotten. What they asked for goes on, since their clients will ask again, but
        can be cancelled.
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
        """Forget jobs that ended long ago. An end that lies ahead, noted by a clock that was fast, is now."""
        now = time.time()
        if not self._database.rows(
            "SELECT 1 FROM jobs WHERE ended < ? OR ended > ? LIMIT 1", [now - self._keep_s, now]
        ):
            return
        with self._database.write() as connection:
            self._forget(connection)

    def _stopped(self, job_id: str, owner: str, why: str) -> bool:
        """The owner's job ends where it was cancelled; else it is queued again, and the attempt does not count."""
        with self._database.write() as connection:
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
