"""A job as a row of the database, and single steps on it within somebody's transaction."""

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


def end_job(connection: Connection, job_id: str, state: str, problem: Mapping[str, Any] | None) -> None:
    """End an active job and tell it; one that has ended stays as it is."""
    changed = connection.execute(
        "UPDATE jobs SET state = ?, ended = ?, problem = ? WHERE id = ? AND state IN ('queued', 'running')",
        [state, time.time(), None if problem is None else json.dumps(problem), job_id],
    )
    if changed.rowcount:
        connection.execute("DELETE FROM waits WHERE job_id = ?", [job_id])
        tell(connection, job_id, "state", {"state": state, **({} if problem is None else {"problem": problem})})


def requeue_job(connection: Connection, job_id: str, why: str, attempts: int = 0) -> None:
    """Queue a running job again."""
    connection.execute(
        "UPDATE jobs SET state = 'queued', owner = NULL, started = NULL, attempts = attempts + ? WHERE id = ?",
        [attempts, job_id],
    )
    tell(connection, job_id, "state", {"state": "queued", "reason": why})


def running_job(connection: Connection, job_id: str, owner: str) -> Row | None:
    """The job, while it is running and this owner's."""
    query = "SELECT * FROM jobs WHERE id = ? AND state = 'running' AND owner = ?"
    return connection.execute(query, [job_id, owner]).fetchone()


def wait_for(connection: Connection, job_id: str, process: str | None) -> None:
    """A request of the process waits for the job's answer; none does where there is no process."""
    if process is not None:
        connection.execute("INSERT INTO waits (job_id, process) VALUES (?, ?)", [job_id, process])


def cancel_unwanted(connection: Connection, job_id: str, why: str) -> bool:
    """A queued job ends at once, a running one after the stage that it is in. Returns whether it is over by this."""
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
    """Note an event under the next number."""
    connection.execute(
        "INSERT INTO events (job_id, seq, name, data)"
        " SELECT ?, 1 + coalesce(max(seq), 0), ?, ? FROM events WHERE job_id = ?",
        [job_id, name, json.dumps(data), job_id],
    )


def found_job(connection: Connection, job_id: str) -> Job:
    """Raises `JobNotFound`."""
    row = connection.execute(f"{JOBS} WHERE id = ?", [job_id]).fetchone()
    if row is None:
        raise unknown_job(job_id)
    return job_of(row)


def job_of(row: Row) -> Job:
    """The job that a row is."""
    values: dict[str, Any] = dict(row)
    values |= {name: bool(values[name]) for name in ("kept", "cancelled")}
    if values["problem"] is not None:
        values["problem"] = json.loads(values["problem"])
    return Job(**values)


def unknown_job(job_id: str) -> GapmesError:
    """What is said of an id that is none."""
    return JobNotFound(f"no job {job_id[:64]!r}", field="job", cure="ended jobs are forgotten after a while")
