"""Routes of jobs: state, server-sent events, and cancelling."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator, AsyncIterator, Mapping, Sequence
from contextlib import aclosing
from datetime import UTC, datetime
from typing import Annotated, Any

import anyio
import anyio.to_thread
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BeforeValidator, Field

from ..errors import JobCancelled, JobNotFound
from ..jobs.rows import Event, Job
from ..problem_document import of_error
from .parameters import Parameters, whole
from .responses import head_alone, json_response
from .runtime import Runtime, RuntimeDep
from .schemas import Job as JobSchema

router = APIRouter(tags=["jobs"])

EVENTS = "text/event-stream"
LOOK_S = 0.2  # between polls for new events
RETRY_MS = 2000  # after which a browser connects again


def wanted_async(preferences: Sequence[str]) -> bool:
    """Whether Prefer headers (RFC 7240) contain `respond-async`."""
    tokens = [token for header in preferences for token in header.split(",")]
    return "respond-async" in [token.partition(";")[0].strip().lower() for token in tokens]  # without parameters


def accepted_job(runtime: Runtime, job: Job, said: Mapping[str, Any]) -> Response:
    """202 with the document of the job and `said`, members about the request itself; to be called on a worker
    thread."""
    headers = {"Location": f"/jobs/{job.id}", "Preference-Applied": "respond-async", "Vary": "Accept, Prefer"}
    return json_response({**job_document(runtime, job), **said}, 202, headers)


def why_not(job: Job) -> dict[str, Any]:
    """The problem document of a failed or cancelled job."""
    if job.problem is not None:
        return job.problem
    return of_error(JobCancelled("the job was cancelled", cure="ask for it again"))


class EventsQuery(Parameters):
    """Which events."""

    after: Annotated[int, BeforeValidator(whole)] = Field(
        0, ge=0, le=2**31, description="as Last-Event-ID, where headers cannot be set"
    )
    last_event_id: Annotated[int, BeforeValidator(whole)] = Field(
        0, alias="lastEventId", ge=0, le=2**31, description="the same, as replacements of EventSource name it"
    )


@router.head("/jobs/{job_id:path}/events", include_in_schema=False)
@router.get("/jobs/{job_id:path}/events", response_class=StreamingResponse, responses={200: {"content": {EVENTS: {}}}})
async def job_events(
    request: Request,
    job_id: str,
    runtime: RuntimeDep,
    query: Annotated[EventsQuery, Query()],
    last_event_id: Annotated[str | None, Header(description="number of the last event that was received")] = None,
) -> Response:
    """Server-sent events `state` and `stage`, numbered, from the first or after the last one received, with comments as
    a heartbeat; the stream ends with the job."""
    await anyio.to_thread.run_sync(runtime.jobs.table.get, job_id)
    after = max(query.after, query.last_event_id)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    if request.method == "HEAD":
        return head_alone(EVENTS, headers)
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = int(last_event_id[:10])
    events = _events(request, runtime, job_id, after)
    first = await anext(events)  # occupies a slot, or raises `ServiceBusy` before the answer has begun
    return StreamingResponse(_from(first, events), media_type=EVENTS, headers=headers)


@router.head("/jobs/{job_id:path}", include_in_schema=False)
@router.get("/jobs/{job_id:path}", response_model=JobSchema)
def get_job(job_id: str, runtime: RuntimeDep) -> Response:
    """The job's state, how many jobs are ahead, its current stage, and at the end its scene or the problem."""
    job = runtime.jobs.table.get(job_id)
    headers = {"Cache-Control": "no-store"}
    return json_response(job_document(runtime, job), headers=headers)


@router.delete("/jobs/{job_id:path}", response_model=JobSchema)
def cancel_job(job_id: str, runtime: RuntimeDep) -> Response:
    """Cancel a job: a queued one at once, a running one after its current stage. A job that has ended stays unchanged,
    and one whose scene other requests wait for goes on."""
    return json_response(job_document(runtime, runtime.jobs.cancel(job_id)))


def job_document(runtime: Runtime, job: Job) -> dict[str, Any]:
    """The job as JSON values; `problem` and `links.scene` are present once they exist. To be called on a worker
    thread."""
    table = runtime.jobs.table
    document: dict[str, Any] = {
        "id": job.id,
        "state": job.state,
        "created": _time(job.created),
        "started": _time(job.started),
        "ended": _time(job.ended),
        "attempts": job.attempts,
        "ahead": table.ahead(job) if job.state == "queued" else 0,
        "stage": table.last_stage(job.id) if job.state == "running" else None,
        "links": {"self": f"/jobs/{job.id}", "events": f"/jobs/{job.id}/events"},
    }
    if job.state == "done":
        document["links"]["scene"] = f"/scenes/{job.scene_id}"
    if job.over and job.state != "done":
        document["problem"] = why_not(job)
    return document


async def _events(request: Request, runtime: Runtime, job_id: str, after: int) -> AsyncGenerator[str]:
    table, heard = runtime.jobs.table, time.monotonic()
    async with runtime.streams.slot():
        yield f"retry: {RETRY_MS}\n\n"
        while not runtime.stopping:
            try:
                job = await anyio.to_thread.run_sync(table.get, job_id)  # before the events: none follows its end
            except JobNotFound:  # forgotten, or deleted with the index: who asks for its state is told
                return
            for event in await anyio.to_thread.run_sync(table.events, job_id, after):
                after, heard = event.seq, time.monotonic()
                yield _text(event)
            if job.over or await request.is_disconnected():
                return
            if time.monotonic() - heard > runtime.settings.heartbeat_seconds:
                heard = time.monotonic()
                yield ": still here\n\n"
            await anyio.sleep(LOOK_S)


async def _from(first: str, rest: AsyncGenerator[str]) -> AsyncIterator[str]:
    """`first`, then `rest`, which is closed with this generator."""
    async with aclosing(rest):
        yield first
        async for text in rest:
            yield text


def _text(event: Event) -> str:
    return f"id: {event.seq}\nevent: {event.name}\ndata: {json.dumps(event.data)}\n\n"


def _time(seconds: float | None) -> str | None:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
