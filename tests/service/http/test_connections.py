"""Silent, excess and unread connections, over plain sockets: which are closed, which stay."""

from __future__ import annotations

import logging
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import anyio.to_thread
import pytest
import uvicorn
from cli_runs import run

from gapmes.service.http import connections as module
from gapmes.service.http.connections import Connection, most_connections
from gapmes.service.process import logs

PIECE, PIECES = bytes(2**20), 64  # of an answer that no system buffers whole
GET = b"GET %b HTTP/1.1\r\nHost: gapmes\r\n\r\n"


class App:
    """Answers at once, with more than any buffer holds, or after a while."""

    def __init__(self) -> None:
        self.ended = threading.Event()  # the large answer is over, sent or not
        self.begun, self.go_on = threading.Event(), threading.Event()

    async def __call__(self, scope: Any, _: Any, send: Any) -> None:
        if scope["type"] != "http":
            return
        large = scope["path"] == "/large"
        if scope["path"] == "/wait":
            self.begun.set()
            await anyio.to_thread.run_sync(self.go_on.wait)
        size = len(PIECE) * PIECES if large else 2
        headers = [(b"content-length", str(size).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        for _ in range(PIECES if large else 0):
            await send({"type": "http.response.body", "body": PIECE, "more_body": True})
        await send({"type": "http.response.body", "body": b"" if large else b"ok"})
        if large:
            self.ended.set()


@contextmanager
def served(app: App) -> Iterator[tuple[str, int]]:
    listener = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(app, http=Connection, log_config=None, access_log=False, lifespan="off")
    config.timeout_graceful_shutdown = 1
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=[[listener]])
    thread.start()
    try:
        yield listener.getsockname()
    finally:
        app.go_on.set()
        server.should_exit = True
        thread.join()


@pytest.fixture
def app() -> App:
    return App()


@pytest.fixture
def address(app: App) -> Iterator[tuple[str, int]]:
    with served(app) as address:
        yield address


def connected(address: tuple[str, int]) -> socket.socket:
    return socket.create_connection(address, timeout=120)


def asked(connection: socket.socket, path: bytes = b"/") -> bytes:
    connection.sendall(GET % path)
    return connection.recv(9)


def rest(connection: socket.socket) -> bytes:
    """All data until the other side closes the connection, also by a reset."""
    found = b""
    try:
        while data := connection.recv(2**20):
            found += data
    except ConnectionResetError:
        pass
    return found


@pytest.mark.parametrize("begin", [b"", b"GET /heal", b"GET / HTTP/1.1\r\nHost: gapmes\r\n"])
def test_a_connection_without_a_whole_head_ends(
    monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int], begin: bytes
) -> None:
    """At the first request, and behind one that was answered."""
    for before in (False, True):
        monkeypatch.setattr(module, "HEAD_S", 120.0 if before else 0.3)
        with connected(address) as connection:
            if before:
                connection.sendall(GET % b"/wait")
                assert app.begun.wait(120)
                monkeypatch.setattr(module, "HEAD_S", 0.3)  # from the end of the answer on
                app.go_on.set()
                assert connection.recv(9) == b"HTTP/1.1 "
            connection.sendall(begin)
            assert rest(connection)[-2:] == (b"ok" if before else b"")


def test_a_request_that_is_answered_is_not_silent(
    monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int]
) -> None:
    """However long the answer takes; nor is a request that arrives in pieces."""
    monkeypatch.setattr(module, "HEAD_S", 1.0)
    with connected(address) as connection:
        for byte in GET % b"/wait":
            connection.sendall(bytes([byte]))
        assert app.begun.wait(120)
        time.sleep(2 * module.HEAD_S)
        app.go_on.set()
        assert rest(connection).endswith(b"ok")


def test_of_too_many_the_one_that_is_silent_for_the_longest_time_goes(
    monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    """Data that was sent with a connection is read first."""
    monkeypatch.setattr(module, "most_connections", lambda: 3)
    monkeypatch.setattr(module, "CROWDED_S", 0.3)
    with connected(address) as busy, connected(address) as first, connected(address) as second:
        busy.sendall(GET % b"/wait")
        assert app.begun.wait(120)
        with connected(address) as third:
            assert first.recv(1) == b""
            assert asked(third) == b"HTTP/1.1 "
            with connected(address) as fourth:
                assert second.recv(1) == b""
                assert asked(fourth) == b"HTTP/1.1 "
        app.go_on.set()
        assert rest(busy).endswith(b"ok")
    assert "the limit of 3 connections is reached" in caplog.text


def test_where_all_are_answered_the_new_one_goes(
    monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int]
) -> None:
    """At twice as many as there may be: as many more are waited for, and answered where they ask."""
    monkeypatch.setattr(module, "most_connections", lambda: 1)
    monkeypatch.setattr(module, "CROWDED_S", 0.3)
    with connected(address) as busy, connected(address) as other:
        for one in (busy, other):
            app.begun.clear()
            one.sendall(GET % b"/wait")
            assert app.begun.wait(120)
        with connected(address) as new:
            assert rest(new) == b""
        time.sleep(2 * module.CROWDED_S)
        app.go_on.set()
        for one in (busy, other):
            assert rest(one).endswith(b"ok")


def test_beyond_twice_as_many_one_goes_at_once(monkeypatch: pytest.MonkeyPatch, address: tuple[str, int]) -> None:
    """However long a burst is waited for otherwise."""
    monkeypatch.setattr(module, "most_connections", lambda: 3)
    monkeypatch.setattr(module, "CROWDED_S", 600.0)
    with ExitStack() as stack:
        first, *others = [stack.enter_context(connected(address)) for _ in range(7)]
        assert first.recv(1) == b""
        for one in others:
            assert asked(one) == b"HTTP/1.1 "


def test_a_burst_of_clients_is_answered(monkeypatch: pytest.MonkeyPatch, address: tuple[str, int]) -> None:
    """All that there may be twice, at once, each with its request."""
    monkeypatch.setattr(module, "most_connections", lambda: 20)
    with ExitStack() as stack:
        clients = [stack.enter_context(connected(address)) for _ in range(40)]
        for client in clients:
            client.sendall(GET % b"/")
        assert [client.recv(9) for client in clients] == [b"HTTP/1.1 "] * 40


def test_there_are_fewer_than_files_may_be_open() -> None:
    files, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        for limit, most in ((256, 85), (min(1024, hard), 341)):
            resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
            assert most_connections() == most
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, hard))


def test_as_many_files_are_asked_for_as_the_bound_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: asked.append(limits))
    for had, allowed, wanted in (
        (1024, 4096, [(4096, 4096)]),
        (1024, resource.RLIM_INFINITY, [(module.FILES, resource.RLIM_INFINITY)]),
        (module.FILES, 2**20, []),
        (resource.RLIM_INFINITY, resource.RLIM_INFINITY, []),
    ):
        asked.clear()
        monkeypatch.setattr(resource, "getrlimit", lambda _, both=(had, allowed): both)
        module.ask_for_files()
        assert asked == wanted


def test_an_answer_that_nobody_reads_ends(monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int]) -> None:
    monkeypatch.setattr(module, "LOOK_S", 0.3)
    with connected(address) as connection:
        connection.sendall(GET % b"/large")
        assert app.ended.wait(120)
        assert len(rest(connection)) < len(PIECE) * PIECES


def test_an_answer_that_is_read_slowly_does_not(
    monkeypatch: pytest.MonkeyPatch, app: App, address: tuple[str, int]
) -> None:
    monkeypatch.setattr(module, "LOOK_S", 1.0)
    with socket.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**16)
        connection.settimeout(120)
        connection.connect(address)
        connection.sendall(GET % b"/large")
        size = 0
        for _ in range(35):  # longer than three looks, and slower than the system fills what it has
            time.sleep(0.1)
            size += len(connection.recv(2**16))
        while data := connection.recv(2**20):
            size += len(data)
            if size > len(PIECE) * PIECES:
                break
        assert size > len(PIECE) * PIECES
        assert app.ended.wait(120)


def test_what_clients_can_cause_is_said_once_in_a_while(capsys: pytest.CaptureFixture[str]) -> None:
    """Also that there are no files left, which the event loop says at every attempt, with a traceback."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        logs.configure("text")
        for _ in range(100):
            message = f"{logs.NO_FILES}\nsocket: <asyncio.TransportSocket fd=6>"
            logging.getLogger("asyncio").error(message, exc_info=OSError(24, "Too many open files"))
            logging.getLogger("gapmes").warning("%s of %d connections is reached", logs.OVER_LIMIT, 85)
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith("error   no further connection: raise the limit of open files")
    assert second.endswith("the limit of 85 connections is reached")


def test_the_service_bounds_its_connections_as_documented(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found: list[dict[str, Any]] = []
    monkeypatch.setattr(uvicorn, "run", lambda _, **options: found.append(options))
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setenv("GAPMES_PORT", "0")
    monkeypatch.setenv("GAPMES_STORE", str(tmp_path))
    assert run("serve") == 0
    text = (Path(__file__).parents[3] / "docs" / "operations.md").read_text(encoding="utf-8")
    assert f"{module.HEAD_S:g} s" in text
    assert f"less than {module.LEAST // 2**10} KiB of an answer in {module.LOOK_S:g} s" in text
    assert "a third of the files that it may open (`ulimit -n`, " in text
    assert f"raised to {module.FILES:,} where the hard limit allows it), {module.MOST:,} at most" in text
    assert module.SHARE == 3
    config = uvicorn.Config(App(), http=found[0]["http"], log_config=None)
    config.load()
    assert config.http_protocol_class is Connection
    assert found[0]["backlog"] == module.BACKLOG
    assert found[0]["timeout_keep_alive"] == module.HEAD_S
