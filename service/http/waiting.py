"""Waiting for a job within a request, until it ends, the client disconnects, or the time is up."""

from __future__ import annotations

import asyncio
import time
from functools import partial

import anyio
import anyio.to_thread
from starlette.requests import ClientDisconnect

from ..errors import DeadlineExceeded, InputsGone, JobNotFound
from ..jobs.job_service import JobService
from ..jobs.rows import Job
from .concurrency import Gone

FIRST_S, LAST_S, SHARE = 0.005, 0.2, 0.05  # polling interval: a share of the time passed, between these bounds


async def ended(jobs: JobService, job: Job, patience_s: float, gone: Gone) -> Job:
    """The job once it has ended. Raises `ClientDisconnect` or `DeadlineExceeded`; then the job is cancelled if nobody
    else wants it. Raises `InputsGone` if somebody has deleted the index.

    If the wait is cancelled because this process shuts down, the job is left to another process.
    """
    start = time.monotonic()
    over = goes_on = False
    try:
        while True:
            try:
                job = await anyio.to_thread.run_sync(jobs.table.get, job.id)
            except JobNotFound as error:
                raise InputsGone("the job was deleted, with the index of the store", cure="ask for it again") from error
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
    except asyncio.CancelledError:
        goes_on = jobs.draining
        raise
    finally:
        if not over:
            with anyio.CancelScope(shield=True):
                await anyio.to_thread.run_sync(partial(jobs.leave, job.id, goes_on=goes_on))
