"""Internal errors: the client is told that there was one, and the log leads from the request to it."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
from collections.abc import Iterator
from typing import Any, cast

import pytest
from http_requests import assert_problem, photograph, post, wait_until_ready
from starlette.requests import ClientDisconnect
from starlette.testclient import TestClient
from starlette.types import Receive, Scope, Send

from gapmes.service.app import create_app
from gapmes.service.errors import GapmesError
from gapmes.service.http.problems import FaultsAnswered
from gapmes.service.problem_document import public
from gapmes.service.process.logs import REQUEST_ID
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings

ORIGIN = "https://one.example"


def broken(*_: object, **__: object) -> None:
    raise ZeroDivisionError("secret")


@pytest.fixture(scope="module")
def called(settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service that pages of another origin may call."""
    changed = {"store": tmp_path_factory.mktemp("called") / "scenes", "cors_origins": ORIGIN}
    with TestClient(create_app(settings.model_copy(update=changed)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


def test_a_fault_of_a_job_can_be_traced_to_its_request(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The line of the request names the job, and that of the fault the request."""
    ids: list[str | None] = []
    monkeypatch.setattr(Reconstructor, "reconstruct", broken)
    monkeypatch.setattr(caplog.handler, "filters", [lambda _: ids.append(REQUEST_ID.get()) or True])
    with caplog.at_level(logging.INFO):
        answer = post(client, [photograph(910), photograph(911)])
    assert_problem(answer, 500, "internal_error")
    told = list(zip(caplog.records, ids, strict=True))
    [(fault, mine)] = [(record, request_id) for record, request_id in told if record.levelno == logging.ERROR]
    assert mine == answer.headers["x-request-id"]
    [line] = [record for record in caplog.records if record.name == "gapmes.access"]
    assert fault.getMessage() == f"job {line.job} failed"


@pytest.mark.parametrize(
    ("error", "code", "what"),
    [
        (ZeroDivisionError("secret"), "internal_error", "an unexpected ZeroDivisionError"),
        (GapmesError("secret", field="secret", index=1), "internal_error", "GapmesError"),
    ],
)
def test_of_a_fault_only_its_kind_is_told(error: Exception, code: str, what: str) -> None:
    told = public(error)
    assert (told["status"], told["code"], told["detail"]) == (500, code, f"the service failed with {what}")
    assert "secret" not in str(told)


def test_a_page_that_may_call_can_read_of_a_fault(called: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(called.app.state.runtime.store, "page", broken)
    answer = called.get("/scenes", headers={"Origin": ORIGIN, "X-Request-ID": "mine"})
    assert_problem(answer, 500, "internal_error")
    told = {"access-control-allow-origin": ORIGIN, "x-content-type-options": "nosniff", "x-request-id": "mine"}
    assert told.items() <= answer.headers.items()
    assert "secret" not in answer.text


def test_who_finds_no_file_left_to_open_may_try_again(
    called: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), "scene.ply")

    monkeypatch.setattr(SceneStore, "document", full)
    answer = called.get(f"/scenes/{'a' * 32}")
    assert_problem(answer, 503, "service_busy")
    assert int(answer.headers["retry-after"]) > 0
    assert ["Traceback" in caplog.text, caplog.text.count("the limit of open files")] == [False, 1]


def test_a_client_that_goes_away_is_no_fault(
    called: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Amid its upload, or before its picture is drawn: nobody reads the answer, and no fault is logged."""

    def left(*_: object) -> None:
        raise ClientDisconnect

    monkeypatch.setattr(called.app.state.runtime.store, "page", left)
    assert_problem(called.get("/scenes"), 400, "client_disconnected")
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_a_fault_amid_an_answer_goes_on() -> None:
    """Nothing may follow what was sent: the server ends the connection."""
    sent: list[Any] = []

    async def half(_: Scope, __: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        broken()

    async def send(message: Any) -> None:
        sent.append(message["type"])

    with pytest.raises(ZeroDivisionError):
        asyncio.run(FaultsAnswered(half)({"type": "http"}, cast(Receive, None), send))
    assert sent == ["http.response.start"]
