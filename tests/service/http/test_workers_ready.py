"""One of several processes: when it reports the service ready, when it answers, when it ends."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn
from http_requests import assert_problem
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.http import runtime
from gapmes.service.process.peers import FOLDER, Peers
from gapmes.service.settings import Settings


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that the processes share."""
    (tmp_path / "shared").mkdir()
    monkeypatch.setenv(FOLDER, str(tmp_path / "shared"))
    return tmp_path / "shared"


@pytest.fixture
def other(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Another process of ours, which is loaded."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    (folder / f"loaded_{process.pid}").touch()
    yield process
    process.kill()
    process.wait()


def one_of_two(settings: Settings, store: Path, **more: object) -> TestClient:
    app = create_app(settings.model_copy(update={"store": store, "workers": 2, **more}))
    return TestClient(app, raise_server_exceptions=False)


def until_loaded(client: TestClient) -> dict[str, object]:
    deadline = time.monotonic() + 300
    while (body := client.get("/readyz").json()).get("stage", "ready") != "ready":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return body


def test_it_is_not_ready_before_the_other_is(settings: Settings, tmp_path: Path, folder: Path) -> None:
    with one_of_two(settings, tmp_path / "scenes") as client:
        assert until_loaded(client)["detail"] == "1 of 2 processes are loaded"
        problem = assert_problem(client.get("/readyz"), 503, "model_not_ready")
        assert (problem["state"], problem["stage"]) == ("starting", "ready")
        assert client.get("/models").status_code == 200  # it does what it is asked for
        (folder / "complete").touch()
        assert client.get("/readyz").status_code == 200


@pytest.mark.usefixtures("other")
def test_the_last_one_makes_them_ready(settings: Settings, tmp_path: Path) -> None:
    with one_of_two(settings, tmp_path / "scenes") as client:
        assert until_loaded(client)["status"] == "ready"


def test_a_refusal_names_the_stage_that_it_was_decided_in(
    settings: Settings, tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Were it the stage of a moment later, "ready", it would say that another process is missing, which none is."""
    app = create_app(settings.model_copy(update={"store": tmp_path / "scenes", "workers": 2}))
    with TestClient(app, raise_server_exceptions=False) as client:
        until_loaded(client)
        app.state.runtime.stage = "kernels"

        def loaded_right_after(_: Peers) -> bool:
            app.state.runtime.stage = "ready"
            return False

        monkeypatch.setattr(Peers, "complete", property(loaded_right_after))
        assert client.get("/readyz").json()["stage"] == "kernels"


@pytest.mark.usefixtures("other")
def test_in_place_of_another_it_listens_when_it_is_loaded(settings: Settings, tmp_path: Path, folder: Path) -> None:
    (folder / "complete").touch()
    with one_of_two(settings, tmp_path / "scenes") as client:
        assert client.get("/readyz").status_code == 200  # the first answer of all


def test_it_listens_at_once_where_nobody_else_does(tmp_path: Path, folder: Path) -> None:
    """Were it silent, a probe would hang; what keeps it from loading is told."""
    (folder / "complete").touch()
    with one_of_two(Settings(model=tmp_path / "none.onnx"), tmp_path / "scenes") as client:
        deadline = time.monotonic() + 300
        while (body := client.get("/readyz").json())["state"] == "starting":
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert body["state"] == "failed"


@pytest.mark.parametrize("complete", [False, True])
def test_one_that_cannot_be_loaded_ends_where_another_is(
    tmp_path: Path, folder: Path, other: subprocess.Popen[bytes], complete: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server starts a process in its place. In order where it has begun to answer, else before it would."""
    if complete:
        (folder / "complete").touch()
    ended = threading.Event()
    how: list[object] = []

    def end(*told: object) -> None:
        how.append(told)
        ended.set()
        other.kill()  # else this one, which cannot end here, would never listen
        other.wait()

    monkeypatch.setattr(runtime, "RETRY_S", 0.05)
    monkeypatch.setattr(runtime, "_quit", lambda: end("at once"))
    monkeypatch.setattr(runtime, "_terminate", lambda: end("in order"))
    with one_of_two(Settings(model=tmp_path / "none.onnx"), tmp_path / "scenes"):
        assert ended.wait(300)
    assert how == [("at once" if complete else "in order",)]


@pytest.mark.usefixtures("other")
def test_one_that_was_told_to_end_before_it_could_hear_it_ends(
    settings: Settings, tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its server, which imports the application only then; it does not wait to be loaded, which may never be."""
    (folder / "complete").touch()
    never = threading.Event()
    monkeypatch.setattr(runtime.Runtime, "_load", lambda _: never.wait(120))
    server = uvicorn.Server(uvicorn.Config("gapmes.service.serving:app"))
    ours = runtime.Runtime(settings.model_copy(update={"store": tmp_path / "scenes", "workers": 2}))

    async def lifespan() -> None:
        async with ours.running():
            assert ours.stopping

    before = signal.signal(signal.SIGTERM, server.handle_exit)
    try:
        server.handle_exit(signal.SIGTERM, None)
        asyncio.run(asyncio.wait_for(lifespan(), 60))
    finally:
        signal.signal(signal.SIGTERM, before)
        never.set()
