"""Read-only queries of the tables of jobs and events."""

from __future__ import annotations

import json
from typing import Any

from ..scenes.database import Database
from .rows import ACTIVE, JOBS, Event, Job, job_of, unknown_job


class JobReader:
    """Queries that are safe from any thread and process of the store."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def get(self, job_id: str) -> Job:
        """Raises `JobNotFound`."""
        rows = self._database.rows(f"{JOBS} WHERE id = ?", [job_id])
        if not rows:
            raise unknown_job(job_id)
        return job_of(rows[0])

    def ahead(self, job: Job) -> int:
        """Number of jobs that are running, or queued before this one."""
        rows = self._database.rows(
            "SELECT count(*) FROM jobs WHERE id != ? "
            "AND (state = 'running' OR (state = 'queued' AND rowid < (SELECT rowid FROM jobs WHERE id = ?)))",
            [job.id, job.id],  # it may have been claimed since it was read
        )
        return int(rows[0][0])

    def events(self, job_id: str, after: int = 0) -> list[Event]:
        """The job's events with a number above `after`, in order."""
        rows = self._database.rows("SELECT * FROM events WHERE job_id = ? AND seq > ? ORDER BY seq", [job_id, after])
        return [Event(row["seq"], row["name"], json.loads(row["data"])) for row in rows]

    def last_stage(self, job_id: str) -> dict[str, Any] | None:
        """Data of the job's latest stage event, None if there is none."""
        query = "SELECT data FROM events WHERE job_id = ? AND name = 'stage' ORDER BY seq DESC LIMIT 1"
        rows = self._database.rows(query, [job_id])
        return json.loads(rows[0]["data"]) if rows else None

    def counts(self) -> dict[str, int]:
        """Number of jobs by state, `queued` and `running`."""
        found = self._database.rows(
            "SELECT state, count(*) AS n FROM jobs WHERE state IN ('queued', 'running') GROUP BY state"
        )
        return dict.fromkeys(ACTIVE, 0) | {row["state"]: row["n"] for row in found}

    def unfinished(self) -> set[str]:
        """Ids of the active jobs."""
        return {row["id"] for row in self._database.rows("SELECT id FROM jobs WHERE state IN ('queued', 'running')")}

    def processes(self) -> set[str]:
        """Lease names of the processes that run jobs, or whose requests wait for jobs."""
        query = "SELECT owner AS process FROM jobs WHERE state = 'running' UNION SELECT process FROM waits"
        return {row["process"] for row in self._database.rows(query)}
