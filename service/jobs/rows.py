"""A job as a row of the database, and changes of it within a transaction of the caller."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from sqlite3 import Connection, Row
from typing import Any

from ..errors import GapmesError, JobNotFound

ACTIVE = ("queued", "running")
JOBS = "SELECT *, (SELECT count(*) FROM waits WHERE job_id = jobs.id) AS waiting FROM jobs"
ENDED = ("done", "failed", "cancelled")


@dataclass(frozen=True)
class Job:
    """A row of the table `jobs`; times are seconds since 1970."""

    id: str
    scene_id: str
    state: str
    kept: bool  # asked for as a job: runs to its end even if no request waits
    waiting: int  # number of requests that wait for it
    cancelled: bool  # a running job that is to end after its stage
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
    """An event of a job, numbered from 1; its name is `state` (a change of it) or `stage` (progress)."""

    seq: int
    name: str
    data: dict[str, Any]


def end_job(connection: Connection, job_id: str, state: str, problem: Mapping[str, Any] | None) -> None:
    """Set the final state of an active job and add its event. A job that has ended stays unchanged."""
    changed = connection.execute(
        "UPDATE jobs SET state = ?, ended = ?, problem = ? WHERE id = ? AND state IN ('queued', 'running')",
        [state, time.time(), None if problem is None else json.dumps(problem), job_id],
    )
    if changed.rowcount:
        connection.execute("DELETE FROM waits WHERE job_id = ?", [job_id])
        tell(connection, job_id, "state", {"state": state, **({} if problem is None else {"problem": problem})})


def requeue_job(connection: Connection, job_id: str, why: str, attempts: int = 0) -> None:
    """Queue a running job again for the reason `why`; `attempts` is added to their number."""
    connection.execute(
        "UPDATE jobs SET state = 'queued', owner = NULL, started = NULL, attempts = attempts + ? WHERE id = ?",
        [attempts, job_id],
    )
    tell(connection, job_id, "state", {"state": "queued", "reason": why})


def running_job(connection: Connection, job_id: str, owner: str) -> Row | None:
    """The row of a job that this owner is running; None if it is not."""
    query = "SELECT * FROM jobs WHERE id = ? AND state = 'running' AND owner = ?"
    return connection.execute(query, [job_id, owner]).fetchone()


def wait_for(connection: Connection, job_id: str, process: str | None) -> None:
    """Note that a request of `process` waits for the job; nothing if `process` is None."""
    if process is not None:
        connection.execute("INSERT INTO waits (job_id, process) VALUES (?, ?)", [job_id, process])


def cancel_unwanted(connection: Connection, job_id: str, why: str) -> bool:
    """Cancel a job that is not kept and that no request waits for: a queued one at once, a running one after its stage.

    Returns whether this ended it.
    """
    row = connection.execute(f"{JOBS} WHERE id = ?", [job_id]).fetchone()
    if row is None or row["kept"] or row["waiting"] > 0:
        return False
    if row["state"] == "queued":
        end_job(connection, job_id, "cancelled", None)
        return True
    if row["state"] == "running" and not row["cancelled"]:
        connection.execute("UPDATE jobs SET cancelled = 1 WHERE id = ?", [job_id])
        tell(connection, job_id, "state", {"state": "running", "reason": why})
    return False


def tell(connection: Connection, job_id: str, name: str, data: Mapping[str, Any]) -> None:
    """Append an event under the job's next number."""
    connection.execute(
        "INSERT INTO events (job_id, seq, name, data)"
        " SELECT ?, 1 + coalesce(max(seq), 0), ?, ? FROM events WHERE job_id = ?",
        [job_id, name, json.dumps(data), job_id],
    )


def found_job(connection: Connection, job_id: str) -> Job:
    """The job of this id. Raises `JobNotFound`."""
    row = connection.execute(f"{JOBS} WHERE id = ?", [job_id]).fetchone()
    if row is None:
        raise unknown_job(job_id)
    return job_of(row)


def job_of(row: Row) -> Job:
    """The `Job` of a row that `JOBS` selected."""
    values: dict[str, Any] = dict(row)
    values |= {name: bool(values[name]) for name in ("kept", "cancelled")}
    if values["problem"] is not None:
        values["problem"] = json.loads(values["problem"])
    return Job(**values)


def unknown_job(job_id: str) -> GapmesError:
    """The error for an id that no job has."""
    return JobNotFound(f"no job {job_id[:64]!r}", field="job", cure="ended jobs are forgotten after a while")
