"""A process that must end answers all waiting requests with the reason and a cure."""

from __future__ import annotations

import json
import signal
import socket
import sqlite3
import threading
from pathlib import Path
from typing import Any

import anyio
import httpx
import pytest
from http_requests import assert_problem, photograph, post
from served_process import serving, until
from test_serve import cameras_of

from gapmes.service.http.shutdown_deadline import AnsweredInTime, ShutdownDeadline

HEAD = b"POST /reconstruct HTTP/1.1\r\nHost: x\r\nContent-Type: multipart/form-data; boundary=x\r\n"
HEAD += b"Content-Length: 99\r\n\r\n"


def test_who_waits_for_a_scene_or_has_not_sent_all_is_told(tmp_path: Path, standin_model: Path) -> None:
    """The scene waits behind one that has begun; neither is lost."""
    big, cameras = [photograph(k, 1600, 1200) for k in (1, 2, 3)], cameras_of(3, 1600, 1200)
    store, found = tmp_path / "scenes", []
    environment = {"GAPMES_DRAIN_SECONDS": "0", "GAPMES_LOG": "json"}
    with serving(store, standin_model, tmp_path / "log", **environment) as (client, process):
        jobs = [post(client, big, cameras, prefer="respond-async", fade=str(fade)).json() for fade in range(4)]
        work = threading.Thread(target=lambda: found.append(post(client, big, cameras, fade="5")))
        work.start()
        upload = socket.create_connection((client.base_url.host, client.base_url.port), timeout=120)
        upload.sendall(HEAD + b"--x\r\n")
        with sqlite3.connect(store / "index.sqlite") as database:
            until(lambda: database.execute("SELECT count(*) FROM waits").fetchone()[0] == 1)
        database.close()
        until(lambda: 'gapmes_places_taken{of="uploads"} 1.0' in metrics(client))
        process.send_signal(signal.SIGTERM)
        answer = upload.makefile("rb").read()
        assert process.wait(120) == 0
        work.join()
    upload.close()
    problem = assert_problem(found[0], 503, "service_busy", cured=True)
    assert problem["detail"] == "the service is stopping, and the answer takes more than the 0 s that it has"
    assert found[0].headers["retry-after"]
    assert found[0].headers["x-request-id"]
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503 ")
    assert b"x-request-id" in head
    assert json.loads(body) == problem
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log
    assert log.count('"message": "POST /reconstruct 503"') == 2
    with sqlite3.connect(store / "index.sqlite") as database:
        states = database.execute("SELECT state FROM jobs").fetchall()
    database.close()
    assert len(states) == len(jobs) + 1
    assert set(states) <= {("queued",), ("done",)}
    assert ("queued",) in states


def metrics(client: httpx.Client) -> str:
    return httpx.get(f"{client.base_url}/metrics", timeout=120).text


async def _receive() -> dict[str, Any]:
    await anyio.sleep_forever()
    raise AssertionError


@pytest.mark.parametrize("begun", [False, True])
def test_an_answer_that_has_begun_is_no_other_one(*, begun: bool) -> None:
    sent: list[dict[str, Any]] = []
    inside = anyio.Event()

    async def waits(_: Any, receive: Any, send: Any) -> None:
        if begun:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        inside.set()
        await receive()

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    async def run() -> None:
        shutdown_deadline = ShutdownDeadline()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(AnsweredInTime(waits, shutdown_deadline, 1.0), {"type": "http"}, _receive, send)
            await inside.wait()
            shutdown_deadline.end()

    anyio.run(run)
    assert [message.get("status") for message in sent] == ([200] if begun else [503, None])


def test_who_is_ended_for_another_reason_ends() -> None:
    async def waits(_: Any, receive: Any, __: Any) -> None:
        await receive()

    async def send(_: Any) -> None:
        raise AssertionError

    async def run() -> None:
        with anyio.move_on_after(0.01) as scope:
            await AnsweredInTime(waits, ShutdownDeadline(), 1.0)({"type": "http"}, _receive, send)
        assert scope.cancelled_caught

    anyio.run(run)
