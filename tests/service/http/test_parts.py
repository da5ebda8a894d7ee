"""The service's small parts: the queue, Accept, JSON parsing, problem documents."""

from __future__ import annotations

import asyncio
import json
import threading
import time

import numpy as np
import pytest
from starlette.requests import ClientDisconnect

from gapmes.service.errors import InputError, MalformedRequest, NotAcceptable, ServiceBusy
from gapmes.service.http.concurrency import WorkQueue
from gapmes.service.http.jobs import wanted_async
from gapmes.service.http.limits import parse_json
from gapmes.service.http.responses import JSON, PLY, ZIP, accepted
from gapmes.service.problem_document import of_error


async def here() -> bool:
    return False


async def gone() -> bool:
    return True


def held(queue: WorkQueue, seconds: float) -> asyncio.Task[None]:
    return asyncio.create_task(queue.run(lambda: time.sleep(seconds), here))


def test_a_queue_takes_as_many_as_it_says() -> None:
    async def scenario() -> None:
        queue = WorkQueue("pictures", 1, 1, 9.0, "drawing")
        tasks = [held(queue, 0.05), held(queue, 0.05)]
        await asyncio.sleep(0)
        with pytest.raises(ServiceBusy, match="2 requests are drawing, the limit is 2"):
            await queue.run(lambda: None, here)
        await asyncio.gather(*tasks)
        assert await queue.run(lambda: 7, here) == 7

    asyncio.run(scenario())


def test_a_queue_survives_a_failure_inside() -> None:
    async def scenario() -> None:
        queue = WorkQueue("pictures", 1, 0, 9.0, "drawing")
        for _ in range(3):
            with pytest.raises(ZeroDivisionError):
                await queue.run(lambda: 1 / 0, here)
        assert await queue.run(lambda: 7, here) == 7

    asyncio.run(scenario())


def test_nothing_is_drawn_for_a_client_that_left_or_waited_too_long() -> None:
    """The one that is drawing goes on; neither takes its place for good."""
    drawn: list[str] = []

    async def scenario() -> None:
        queue, over = WorkQueue("pictures", 1, 5, 0.2, "drawing"), threading.Event()
        task = asyncio.create_task(queue.run(lambda: over.wait(120), here))
        await asyncio.sleep(0.01)
        with pytest.raises(ClientDisconnect):
            await queue.run(lambda: drawn.append("left"), gone)
        with pytest.raises(ServiceBusy, match=r"no turn within 0\.2 s"):
            await queue.run(lambda: drawn.append("late"), here)
        over.set()
        await task
        await queue.run(lambda: drawn.append("next"), here)

    asyncio.run(scenario())
    assert drawn == ["next"]


@pytest.mark.parametrize(
    ("header", "kind"),
    [
        (None, JSON),
        ("", JSON),
        ("*/*", JSON),
        ("application/zip", ZIP),
        ("APPLICATION/ZIP", ZIP),
        ("application/octet-stream", PLY),
        ("application/json;q=0, */*", PLY),
        ("application/zip;q=0.9, application/json;q=0.8", ZIP),
        ("text/html, */*;q=0.1", JSON),
        ("application/json;q=nan", JSON),
        ("application/zip;q=x, application/json;q=0.5", ZIP),
        ("application/octet-stream;q=-1", PLY),
        ("application/json;q=0_0", JSON),
        ("application/json;q=0.2, application/zip;q=inf", ZIP),
    ],
)
def test_accepted(header: str | None, kind: str) -> None:
    assert accepted(header) == kind


@pytest.mark.parametrize("header", ["text/html", "*/*;q=0", "application/json;q=0.000"])
def test_not_accepted(header: str) -> None:
    with pytest.raises(NotAcceptable):
        accepted(header)


@pytest.mark.parametrize(
    ("preferences", "wanted"),
    [
        (["respond-async"], True),
        (["respond-async; foo=1"], True),
        (["wait=10, Respond-Async ;foo"], True),
        (["wait=10", "respond-async"], True),
        (["wait; respond-async"], False),
        (["respond-asynchronously"], False),
        ([], False),
    ],
)
def test_preferences_have_parameters(preferences: list[str], wanted: bool) -> None:
    assert wanted_async(preferences) == wanted


def test_json_numbers_never_overflow_later() -> None:
    assert parse_json("123456789012345", "x") == 123456789012345
    assert parse_json("1" + "0" * 400, "x") == float("inf")
    assert parse_json("-1" + "0" * 5000, "x") == float("-inf")
    assert np.isnan(parse_json("NaN", "x"))


@pytest.mark.parametrize("text", [b"\xff\xfe", b"{", b"", b"[" * 1_000_000])
def test_json_that_is_none(text: bytes) -> None:
    with pytest.raises(MalformedRequest):
        parse_json(text, "x")


def test_problem_document_is_always_json() -> None:
    error = InputError("no", field="x", extra_array=np.arange(2), nan=float("nan"), status="kept out", odd=object())
    document = of_error(error)
    json.dumps(document, allow_nan=False)
    assert document["status"] == 422
    assert document["extra_array"] == [0, 1]
    assert document["nan"] == "nan"
    assert "index" not in document
