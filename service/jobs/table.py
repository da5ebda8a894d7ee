"""Jobs and their events in the store's database: submitted once per scene, claimed by one process, ended once.

queued -> running -> done | failed | cancelled        queued -> cancelled        running -> queued (its process died)
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from sqlite3 import Connection, Row
from typing import Any

from ..database import Database
from ..errors import GapmesError, JobNotFound, ServiceBusy

ACTIVE = ("queued", "running")
ENDED = ("done", "failed", "cancelled")
MAX_ATTEMPTS = 2  # a job whose process died is tried once more; then it is taken for the reason


@dataclass(frozen=True)
class Job:
    """A row; times are seconds since 1970."""

    id: str
    scene_id: str
    state: str
    kept: bool  # somebody asked for a job, not only for its answer
    waiting: int  # requests that wait for its answer
    cancelled: bool  # asked to end, where it is running
    attempts: int
    owner: str | None  # the lease of the process that computes it
    created: float
    started: float | None
    ended: float | None
    problem: dict[str, Any] | None  # why it failed or was cancelled, RFC 9457

    @property
    def over(self) -> bool:
        return self.state in ENDED


@dataclass(frozen=True)
class Event:
    """What happened to a job, numbered from 1: a change of its `state`, or a step of a `stage`."""

    seq: int
    name: str
    data: dict[str, Any]


class JobTable:
    """All of it is safe for many processes on one store."""

    def __init__(self, database: Database, *, most: int, keep_s: float) -> None:
        """`most` active jobs; ended ones are forgotten after `keep_s` seconds."""
        self._database = database
        self._most = most
        self._keep_s = keep_s

    def active(self, scene_id: str) -> Job | None:
        """The job that computes the scene now or will."""
        rows = self._database.rows(
            "SELECT * FROM jobs WHERE scene_id = ? AND state IN ('queued', 'running')", [scene_id]
        )
        return _job(rows[0]) if rows else None

    def check_room(self) -> None:
        """Raises `ServiceBusy` where no further job would be taken."""
        count = self.counts()
        if sum(count.values()) >= self._most:
            raise self._busy(sum(count.values()))

    def join(self, scene_id: str, *, kept: bool) -> Job | None:
        """Take part in the active job of the scene, if there is one."""
        with self._database.write() as connection:
            return self._joined(connection, scene_id, kept)

    def submit(self, job_id: str, scene_id: str, *, kept: bool) -> Job:
        """Queue a job whose inputs are spooled under `job_id`, or take part in the scene's active one: the answer's id
        tells which. Raises `ServiceBusy`."""
        with self._database.write() as connection:
            there = self._joined(connection, scene_id, kept)
            if there is not None:
                return there
            (active,) = connection.execute("SELECT count(*) FROM jobs WHERE state IN ('queued', 'running')").fetchone()
            if active >= self._most:
                raise self._busy(active)
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, waiting, created) VALUES (?, ?, 'queued', ?, ?, ?)",
                [job_id, scene_id, kept, not kept, time.time()],
            )
            _tell(connection, job_id, "state", {"state": "queued"})
            return _found(connection, job_id)

    def already_done(self, scene_id: str) -> Job:
        """A job that ended when it was asked for, since its scene is stored."""
        now, job_id = time.time(), uuid.uuid4().hex
        with self._database.write() as connection:
            connection.execute(
                "INSERT INTO jobs (id, scene_id, state, kept, waiting, created, ended)"
                " VALUES (?, ?, 'done', 1, 0, ?, ?)",
                [job_id, scene_id, now, now],
            )
            _tell(connection, job_id, "state", {"state": "done"})
            return _found(connection, job_id)

    def claim(self, owner: str) -> Job | None:
        """The oldest queued job, running from now on and this owner's."""
        if not self._database.rows("SELECT 1 FROM jobs WHERE state = 'queued' LIMIT 1"):
            return None  # most looks find nothing, and need not write
        with self._database.write() as connection:
            rows = connection.execute(
                "UPDATE jobs SET state = 'running', owner = ?, started = ?, attempts = attempts + 1 WHERE id ="
                " (SELECT id FROM jobs WHERE state = 'queued' ORDER BY created, id LIMIT 1) RETURNING *",
                [owner, time.time()],
            ).fetchall()
            if not rows:
                return None
            _tell(connection, rows[0]["id"], "state", {"state": "running", "attempt": rows[0]["attempts"]})
            return _job(rows[0])

    def stage(self, job_id: str, data: Mapping[str, Any]) -> bool:
        """Note a step of the work; returns whether it should go on."""
        with self._database.write() as connection:
            _tell(connection, job_id, "stage", data)
            (cancelled,) = connection.execute("SELECT cancelled FROM jobs WHERE id = ?", [job_id]).fetchone()
            return not cancelled

    def end(self, job_id: str, state: str, problem: Mapping[str, Any] | None = None) -> None:
        """The job is done, failed or cancelled; one that has ended stays as it is."""
        with self._database.write() as connection:
            _end(connection, job_id, state, problem)
            self._forget(connection)

    def end_cancelled(self, job_id: str) -> None:
        """The job ended because nobody wanted it; it begins anew where somebody does by now."""
        with self._database.write() as connection:
            if _found(connection, job_id).cancelled:
                _end(connection, job_id, "cancelled", None)
            else:
                _requeue(connection, job_id, "somebody wants it again", attempts=-1)

    def give_back(self, job_id: str) -> None:
        """Queue a job again that this process will not finish; the attempt does not count."""
        with self._database.write() as connection:
            _requeue(connection, job_id, "the process that computed it stopped", attempts=-1)

    def leave(self, job_id: str) -> None:
        """A request does not wait any more; a job that nobody wants is cancelled."""
        with self._database.write() as connection:
            connection.execute("UPDATE jobs SET waiting = max(waiting - 1, 0) WHERE id = ?", [job_id])
            _cancel_unwanted(connection, job_id, "the client went away")

    def cancel(self, job_id: str) -> Job:
        """Nobody asks for the job any more; requests that wait for the same scene keep it going.

        Raises `JobNotFound`.
        """
        with self._database.write() as connection:
            _found(connection, job_id)
            connection.execute("UPDATE jobs SET kept = 0 WHERE id = ?", [job_id])
            _cancel_unwanted(connection, job_id, "it was cancelled")
            return _found(connection, job_id)

    def recover(self, gone: set[str], why: Mapping[str, Any]) -> None:
        """Queue the running jobs of owners that are gone again, or fail them with `why` after the last attempt."""
        with self._database.write() as connection:
            for row in connection.execute("SELECT * FROM jobs WHERE state = 'running'").fetchall():
                if row["owner"] not in gone:
                    continue
                if row["cancelled"]:
                    _end(connection, row["id"], "cancelled", None)
                elif row["attempts"] >= MAX_ATTEMPTS:
                    _end(connection, row["id"], "failed", why)
                else:
                    _requeue(connection, row["id"], "the process that computed it ended unexpectedly")

    def owners(self) -> set[str]:
        """Of the running jobs."""
        return {row["owner"] for row in self._database.rows("SELECT DISTINCT owner FROM jobs WHERE state = 'running'")}

    def get(self, job_id: str) -> Job:
        """Raises `JobNotFound`."""
        rows = self._database.rows("SELECT * FROM jobs WHERE id = ?", [job_id])
        if not rows:
            raise _unknown(job_id)
        return _job(rows[0])

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

    def counts(self) -> dict[str, int]:
        """Queued and running jobs."""
        found = self._database.rows(
            "SELECT state, count(*) AS n FROM jobs WHERE state IN ('queued', 'running') GROUP BY state"
        )
        return dict.fromkeys(ACTIVE, 0) | {row["state"]: row["n"] for row in found}

    def unfinished(self) -> set[str]:
        """Ids of the active jobs."""
        return {row["id"] for row in self._database.rows("SELECT id FROM jobs WHERE state IN ('queued', 'running')")}

    def _joined(self, connection: Connection, scene_id: str, kept: bool) -> Job | None:
        rows = connection.execute(
            "UPDATE jobs SET kept = max(kept, ?), waiting = waiting + ?, cancelled = 0"
            " WHERE scene_id = ? AND state IN ('queued', 'running') RETURNING *",
            [kept, not kept, scene_id],
        ).fetchall()
        return _job(rows[0]) if rows else None

    def _forget(self, connection: Connection) -> None:
        old = [time.time() - self._keep_s]
        connection.execute("DELETE FROM events WHERE job_id IN (SELECT id FROM jobs WHERE ended < ?)", old)
        connection.execute("DELETE FROM jobs WHERE ended < ?", old)

    def _busy(self, active: int) -> ServiceBusy:
        return ServiceBusy(
            f"{active} reconstructions are running or waiting, the limit is {self._most}", cure="retry later"
        )


def _end(connection: Connection, job_id: str, state: str, problem: Mapping[str, Any] | None) -> None:
    changed = connection.execute(
        "UPDATE jobs SET state = ?, ended = ?, problem = ? WHERE id = ? AND state IN ('queued', 'running')",
        [state, time.time(), None if problem is None else json.dumps(problem), job_id],
    )
    if changed.rowcount:
        _tell(connection, job_id, "state", {"state": state, **({} if problem is None else {"problem": problem})})


def _requeue(connection: Connection, job_id: str, why: str, attempts: int = 0) -> None:
    connection.execute(
        "UPDATE jobs SET state = 'queued', owner = NULL, started = NULL, attempts = attempts + ? WHERE id = ?",
        [attempts, job_id],
    )
    _tell(connection, job_id, "state", {"state": "queued", "reason": why})


def _cancel_unwanted(connection: Connection, job_id: str, why: str) -> None:
    """A queued job ends at once, a running one after the stage that it is in."""
    row = connection.execute("SELECT * FROM jobs WHERE id = ?", [job_id]).fetchone()
    if row is None or row["kept"] or row["waiting"] > 0:
        return
    if row["state"] == "queued":
        _end(connection, job_id, "cancelled", None)
    elif row["state"] == "running":
        connection.execute("UPDATE jobs SET cancelled = 1 WHERE id = ?", [job_id])
        _tell(connection, job_id, "state", {"state": "running", "reason": why})


def _tell(connection: Connection, job_id: str, name: str, data: Mapping[str, Any]) -> None:
    connection.execute(
        "INSERT INTO events (job_id, seq, name, data)"
        " SELECT ?, 1 + coalesce(max(seq), 0), ?, ? FROM events WHERE job_id = ?",
        [job_id, name, json.dumps(data), job_id],
    )


def _found(connection: Connection, job_id: str) -> Job:
    row = connection.execute("SELECT * FROM jobs WHERE id = ?", [job_id]).fetchone()
    if row is None:
        raise _unknown(job_id)
    return _job(row)


def _job(row: Row) -> Job:
    values: dict[str, Any] = dict(row)
    values |= {name: bool(values[name]) for name in ("kept", "cancelled")}
    if values["problem"] is not None:
        values["problem"] = json.loads(values["problem"])
    return Job(**values)


def _unknown(job_id: str) -> GapmesError:
    return JobNotFound(f"no job {job_id[:64]!r}", field="job", cure="ended jobs are forgotten after a while")
