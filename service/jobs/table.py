"""Jobs and their events in the store's database: submitted once per scene, claimed by one process, ended once.

queued -> running -> done | failed | cancelled        queued -> cancelled        running -> queued (its process died)
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Mapping
from sqlite3 import Connection
from typing import Any

from ..database import Database
from ..errors import ServiceBusy
from .rows import (
    ACTIVE,
    JOBS,
    Event,
    Job,
    cancel_unwanted,
    end_job,
    found_job,
    job_of,
    requeue_job,
    running_job,
    tell,
    unknown_job,
    wait_for,
)

MAX_ATTEMPTS = 2  # a job whose process died is tried once more; then it is taken for the reason


class JobTable:
    """All of it is safe for many processes on one store."""

    def __init__(self, database: Database, *, most: int, keep_s: float) -> None:
        """`most` active jobs; ended ones are forgotten after `keep_s` seconds."""
        self._database = database
        self._most = most
        self._keep_s = keep_s

    def check_room(self) -> None:
        """Raises `ServiceBusy` where no further job would be taken."""
        count = self.counts()
        if sum(count.values()) >= self._most:
            raise self._busy(sum(count.values()))

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
            if active >= self._most:
                raise self._busy(active)
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, created) VALUES (?, ?, 'queued', ?, ?)",
                [job_id, scene_id, waits is None, time.time()],
            )
            wait_for(connection, job_id, waits)
            tell(connection, job_id, "state", {"state": "queued"})
            return found_job(connection, job_id)

    def already_done(self, scene_id: str) -> Job:
        """A job that ended when it was asked for, since its scene is stored."""
        now, job_id = time.time(), uuid.uuid4().hex
        with self._database.write() as connection:
            self._forget(connection)
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, created, ended) VALUES (?, ?, 'done', 1, ?, ?)",
                [job_id, scene_id, now, now],
            )
            tell(connection, job_id, "state", {"state": "done"})
            return found_job(connection, job_id)

    def claim(self, owner: str, *, waited_for: bool = False) -> Job | None:
        """The oldest queued job, running from now on and this owner's; with `waited_for` one whose answer a request
        waits for."""
        some = "state = 'queued'" + (" AND id IN (SELECT job_id FROM waits)" if waited_for else "")
        if not self._database.rows(f"SELECT 1 FROM jobs WHERE {some} LIMIT 1"):
            return None  # most looks find nothing, and need not write
        with self._database.write() as connection:
            rows = connection.execute(
                "UPDATE jobs SET state = 'running', owner = ?, started = ?, attempts = attempts + 1 WHERE id ="
                f" (SELECT id FROM jobs WHERE {some} ORDER BY created, id LIMIT 1) RETURNING id",
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
            return True

    def end_cancelled(self, job_id: str, owner: str) -> bool:
        """The owner's job ended because nobody wanted it; it begins anew where somebody does by now. Returns whether it
        is over."""
        with self._database.write() as connection:
            row = running_job(connection, job_id, owner)
            if row is None:
                return False
            if row["cancelled"]:
                end_job(connection, job_id, "cancelled", None)
                return True
            requeue_job(connection, job_id, "somebody wants it again", attempts=-1)
            return False

    def give_back(self, job_id: str, owner: str) -> None:
        """Queue a job again that its owner will not finish; the attempt does not count."""
        with self._database.write() as connection:
            if running_job(connection, job_id, owner) is not None:
                requeue_job(connection, job_id, "the process that computed it stopped", attempts=-1)

    def leave(self, job_id: str, process: str) -> bool:
        """A request of a process does not wait any more; a job that nobody wants is cancelled. Returns whether that
        ended it."""
        with self._database.write() as connection:
            one = "SELECT rowid FROM waits WHERE job_id = ? AND process = ? LIMIT 1"
            connection.execute(f"DELETE FROM waits WHERE rowid IN ({one})", [job_id, process])
            return cancel_unwanted(connection, job_id, "the client went away")

    def cancel(self, job_id: str) -> Job:
        """Nobody asks for the job any more; requests that wait for the same scene keep it going.

        Raises `JobNotFound`.
        """
        with self._database.write() as connection:
            found_job(connection, job_id)
            connection.execute("UPDATE jobs SET kept = 0 WHERE id = ?", [job_id])
            cancel_unwanted(connection, job_id, "it was cancelled")
            return found_job(connection, job_id)

    def recover(self, gone: set[str], why: Mapping[str, Any]) -> set[str]:
        """Queue the running jobs of processes that are gone again, or fail them with `why` after the last attempt.
        Returns the ids of those that are over.

        Requests that waited there are forgotten. What they asked for goes on, since their clients will ask again, but
        can be cancelled.
        """
        over = set()
        with self._database.write() as connection:
            connection.executemany("DELETE FROM waits WHERE process = ?", [[process] for process in gone])
            for row in connection.execute("SELECT * FROM jobs WHERE state = 'running'").fetchall():
                if row["owner"] not in gone:
                    continue
                if row["cancelled"]:
                    end_job(connection, row["id"], "cancelled", None)
                    over.add(row["id"])
                elif row["attempts"] >= MAX_ATTEMPTS:
                    end_job(connection, row["id"], "failed", why)
                    over.add(row["id"])
                else:
                    requeue_job(connection, row["id"], "the process that computed it ended unexpectedly")
        return over

    def processes(self) -> set[str]:
        """Those that compute jobs, and those whose requests wait for some."""
        query = "SELECT owner AS process FROM jobs WHERE state = 'running' UNION SELECT process FROM waits"
        return {row["process"] for row in self._database.rows(query)}

    def get(self, job_id: str) -> Job:
        """Raises `JobNotFound`."""
        rows = self._database.rows(f"{JOBS} WHERE id = ?", [job_id])
        if not rows:
            raise unknown_job(job_id)
        return job_of(rows[0])

    def ahead(self, job: Job) -> int:
        """How many are queued before it or running."""
        rows = self._database.rows(
            "SELECT count(*) FROM jobs WHERE state = 'running' OR (state = 'queued' AND (created, id) < (?, ?))",
            [job.created, job.id],
        )
        return int(rows[0][0])

    def events(self, job_id: str, after: int = 0) -> list[Event]:
        """Those with a number above `after`, in order."""
        rows = self._database.rows("SELECT * FROM events WHERE job_id = ? AND seq > ? ORDER BY seq", [job_id, after])
        return [Event(row["seq"], row["name"], json.loads(row["data"])) for row in rows]

    def last_stage(self, job_id: str) -> dict[str, Any] | None:
        """The step that was noted last, if any."""
        query = "SELECT data FROM events WHERE job_id = ? AND name = 'stage' ORDER BY seq DESC LIMIT 1"
        rows = self._database.rows(query, [job_id])
        return json.loads(rows[0]["data"]) if rows else None

    def forget(self) -> None:
        """Forget jobs that ended long ago."""
        if not self._database.rows("SELECT 1 FROM jobs WHERE ended < ? LIMIT 1", [time.time() - self._keep_s]):
            return
        with self._database.write() as connection:
            self._forget(connection)

    def counts(self) -> dict[str, int]:
        """Queued and running jobs."""
        found = self._database.rows(
            "SELECT state, count(*) AS n FROM jobs WHERE state IN ('queued', 'running') GROUP BY state"
        )
        return dict.fromkeys(ACTIVE, 0) | {row["state"]: row["n"] for row in found}

    def unfinished(self) -> set[str]:
        """Ids of the active jobs."""
        return {row["id"] for row in self._database.rows("SELECT id FROM jobs WHERE state IN ('queued', 'running')")}

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
        old = [time.time() - self._keep_s]
        connection.execute("DELETE FROM events WHERE job_id IN (SELECT id FROM jobs WHERE ended < ?)", old)
        connection.execute("DELETE FROM jobs WHERE ended < ?", old)

    def _busy(self, active: int) -> ServiceBusy:
        return ServiceBusy(
            f"{active} reconstructions are running or waiting, the limit is {self._most}", cure="retry later"
        )
