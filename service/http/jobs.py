"""Jobs over HTTP: what one is doing, its events as they happen, and ending it."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator, AsyncIterator, Mapping, Sequence
from contextlib import aclosing
from datetime import UTC, datetime
from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BeforeValidator

from ..errors import JobCancelled
from ..jobs.rows import Event, Job
from ..problem_document import of_error
from .parameters import whole
from .responses import head_alone, json_response
from .runtime import Runtime, runtime_of
from .schemas import Job as JobSchema

router = APIRouter(tags=["jobs"])

Held = Annotated[Runtime, Depends(runtime_of)]

EVENTS = "text/event-stream"
LOOK_S = 0.2  # between two looks for new events
RETRY_MS = 2000  # after which a browser connects again


def wanted_async(preferences: Sequence[str]) -> bool:
    """Whether a Prefer header (RFC 7240) asks for an answer before the work is done."""
    tokens = [token for header in preferences for token in header.split(",")]
    return "respond-async" in [token.partition(";")[0].strip().lower() for token in tokens]  # parameters are behind ;


def accepted_job(runtime: Runtime, job: Job, said: Mapping[str, Any]) -> Response:
    """202 with the job, and what belongs to the request alone: `said`."""
    headers = {"Location": f"/jobs/{job.id}", "Preference-Applied": "respond-async", "Vary": "Accept, Prefer"}
    return json_response({**job_document(runtime, job), **said}, 202, headers)


def why_not(job: Job) -> dict[str, Any]:
    """The problem document of a job that ended without a scene."""
    if job.problem is not None:
        return job.problem
    return of_error(JobCancelled("the job was cancelled", cure="ask for it again"))


@router.head("/jobs/{job_id:path}/events", include_in_schema=False)
@router.get("/jobs/{job_id:path}/events", response_class=StreamingResponse, responses={200: {"content": {EVENTS: {}}}})
async def job_events(
    request: Request,
    job_id: str,
    runtime: Held,
    last_event_id: Annotated[str | None, Header(description="number of the last event that was received")] = None,
    after: Annotated[
        int, Query(ge=0, le=2**31, description="the same, where headers cannot be set"), BeforeValidator(whole)
    ] = 0,
) -> Response:
    """Server-sent events: `state` and `stage`, numbered, from the beginning or behind the last one received; comments
    as signs of life; the stream ends with the job."""
    runtime.desk.table.get(job_id)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    if request.method == "HEAD":
        return head_alone(EVENTS, headers)
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = int(last_event_id[:10])
    events = _events(request, runtime, job_id, after)
    first = await anext(events)  # takes the place, or refuses before the answer has begun
    return StreamingResponse(_from(first, events), media_type=EVENTS, headers=headers)


@router.head("/jobs/{job_id:path}", include_in_schema=False)
@router.get("/jobs/{job_id:path}", response_model=JobSchema)
def get_job(job_id: str, runtime: Held) -> Response:
    """State, how many are ahead, the stage that it is in, and the scene or the reason once it ended."""
    job = runtime.desk.table.get(job_id)
    headers = {"Cache-Control": "no-store"}
    return json_response(job_document(runtime, job), headers=headers)


@router.delete("/jobs/{job_id:path}", response_model=JobSchema)
def cancel_job(job_id: str, runtime: Held) -> Response:
    """End a job: at once while it is queued, after its stage while it runs. One that ended stays as it is. Whoever
    waits for the same scene without a job keeps it going."""
    return json_response(job_document(runtime, runtime.desk.cancel(job_id)))


def job_document(runtime: Runtime, job: Job) -> dict[str, Any]:
    """Plain JSON; `problem` and `links.scene` are there once there is one."""
    table = runtime.desk.table
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
    table, heard = runtime.desk.table, time.monotonic()
    async with runtime.streams.place():
        yield f"retry: {RETRY_MS}\n\n"
        while not runtime.stopping:
            over = table.get(job_id).over  # asked first: no event comes after the last
            for event in table.events(job_id, after):
                after, heard = event.seq, time.monotonic()
                yield _text(event)
            if over or await request.is_disconnected():
                return
            if time.monotonic() - heard > runtime.settings.heartbeat_seconds:
                heard = time.monotonic()
                yield ": still here\n\n"
            await anyio.sleep(LOOK_S)


async def _from(first: str, rest: AsyncGenerator[str]) -> AsyncIterator[str]:
    """`first`, then the rest, which ends with this."""
    async with aclosing(rest):
        yield first
        async for text in rest:
            yield text


def _text(event: Event) -> str:
    return f"id: {event.seq}\nevent: {event.name}\ndata: {json.dumps(event.data)}\n\n"


def _time(seconds: float | None) -> str | None:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
