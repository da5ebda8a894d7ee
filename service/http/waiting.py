"""Waiting for a job within a request: until it ended, the client went away, or time is up."""

from __future__ import annotations

import time

import anyio
from starlette.requests import ClientDisconnect

from ..errors import DeadlineExceeded
from ..jobs.table import Job, JobTable
from .gate import Gone

FIRST_S, LAST_S, SHARE = 0.005, 0.2, 0.05  # looks come at a twentieth of the time that has passed, between these


async def ended(table: JobTable, job: Job, patience_s: float, gone: Gone) -> Job:
    """The job once it is over. Raises `ClientDisconnect` or `DeadlineExceeded`, after which it is left."""
    start = time.monotonic()
    over = False
    try:
        while True:
            job = table.get(job.id)
            if job.over:
                over = True
                return job
            passed = time.monotonic() - start
            if passed > patience_s:
                raise DeadlineExceeded(
                    f"the scene was not there within {patience_s:g} s",
                    cure="ask for a job (Prefer: respond-async), or try again",
                )
            if await gone():
                raise ClientDisconnect
            await anyio.sleep(min(max(SHARE * passed, FIRST_S), LAST_S))
    finally:
        if not over:
            table.leave(job.id)
