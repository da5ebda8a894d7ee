"""A request that is answered before its body has ended, over a plain socket: how much of the rest is read, who may read
the answer, and which connections stay."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import anyio
import httpx
import pytest
from served_process import serving

from gapmes.service.http.shutdown_deadline import ShutdownDeadline
from gapmes.service.http.unread import MOST, SMALL, BodyLeft

MIB = 2**20
KEY = "the key"
BUFFERS = 16 * MIB  # what the system takes between the two ends, at most
LIMIT = MOST + 2 * BUFFERS  # of a body
FILE = b'--x\r\nContent-Disposition: form-data; name="images"; filename="a.png"\r\n\r\n'  # and no end of it
MULTIPART = "multipart/form-data; boundary=x"


@pytest.fixture(scope="module")
def address(standin_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    """The address of a service with a key."""
    folder = tmp_path_factory.mktemp("left")
    environment = {"GAPMES_API_KEY": KEY, "GAPMES_MAX_UPLOAD_BYTES": str(LIMIT)}
    with serving(folder / "scenes", standin_model, folder / "log", **environment) as (client, _):
        assert client.base_url.port is not None
        yield client.base_url.host, client.base_url.port


def head(length: int | None, method: str = "POST", path: str = "/check", **headers: str) -> bytes:
    """A request without its body, with this length or in chunks."""
    lines = [f"{method} {path} HTTP/1.1", "Host: gapmes"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    lines.append("Transfer-Encoding: chunked" if length is None else f"Content-Length: {length}")
    return "\r\n".join([*lines, "", ""]).encode()


def connected(address: tuple[str, int]) -> socket.socket:
    return socket.create_connection(address, timeout=120)


def answer(connection: socket.socket) -> tuple[int, dict[str, str]]:
    """Status and headers of the next answer; its body is read too."""
    stream = connection.makefile("rb")
    status = int(stream.readline().split()[1])
    headers = {}
    while line := stream.readline().strip():
        name, _, value = line.decode().partition(":")
        headers[name.lower()] = value.strip()
    stream.read(int(headers["content-length"]))
    return status, headers


REFUSED = {
    401: {},
    406: {"X_API_Key": KEY, "Accept": "image/png", "Content_Type": MULTIPART},
    415: {"X_API_Key": KEY, "Content_Type": "text/plain"},
    413: {"X_API_Key": KEY, "Content_Type": MULTIPART},
}


@pytest.mark.parametrize("chunked", [False, True])
@pytest.mark.parametrize("status", REFUSED)
def test_of_a_refused_body_no_more_is_read_than_helps(address: tuple[str, int], status: int, *, chunked: bool) -> None:
    """The answer arrives while the client still sends; then the connection is closed."""
    length = LIMIT + 1 if status == 413 else LIMIT
    path = "/reconstruct" if status == 406 else "/check"
    piece = FILE.ljust(MIB, b"x")
    with connected(address) as connection:
        connection.sendall(head(None if chunked else length, path=path, **REFUSED[status]))
        sent = 0

        def send() -> None:
            nonlocal sent
            connection.sendall(b"%x\r\n%b\r\n" % (len(piece), piece) if chunked else piece)
            sent += len(piece)

        while chunked and status == 413 and sent <= LIMIT:
            send()
        found, headers = answer(connection)
        assert (found, headers["connection"]) == (status, "close")
        told = sent
        with suppress(BrokenPipeError, ConnectionResetError):
            while sent - told < LIMIT:
                send()
        assert sent - told < MOST + BUFFERS


@pytest.mark.parametrize("status", [401, 413])
def test_who_sends_two_photographs_first_can_read_why_not(address: tuple[str, int], status: int) -> None:
    """Nothing is reset while the client has not read: it sends all before it reads anything."""
    body = bytes(8 * MIB)
    length = len(body) if status == 401 else LIMIT + 1  # of which it has sent so much when it looks
    with connected(address) as connection:
        connection.sendall(head(length, **REFUSED[status]))
        connection.sendall(body)
        found, headers = answer(connection)
        assert (found, headers["connection"]) == (status, "close")
    with httpx.Client(base_url=f"http://{address[0]}:{address[1]}", timeout=120) as client:
        assert client.post("/check", content=body).status_code == 401


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("status", [401, 406, 415])
def test_a_small_refusal_keeps_its_connection(address: tuple[str, int], status: int, *, together: bool) -> None:
    body = bytes(SMALL)
    path = "/reconstruct" if status == 406 else "/check"
    with connected(address) as connection:
        for _ in range(2):
            first = head(len(body), path=path, **REFUSED[status])
            for data in (first + body,) if together else (first, body):
                connection.sendall(data)
            found, headers = answer(connection)
            assert found == status
            assert "connection" not in headers
        connection.sendall(head(0, "GET", "/healthz"))
        assert answer(connection)[0] == 200


def test_a_body_that_was_read_keeps_its_connection(address: tuple[str, int]) -> None:
    body = b'--x\r\nContent-Disposition: form-data; name="near"\r\n\r\n' + b"1\r\n--x--\r\n" + bytes(2 * SMALL)
    with connected(address) as connection:
        for _ in range(2):
            connection.sendall(head(len(body), X_API_Key=KEY, Content_Type=MULTIPART) + body)
            found, headers = answer(connection)
            assert found == 422
            assert "connection" not in headers


def test_a_small_body_that_does_not_come_is_not_waited_for_long(address: tuple[str, int]) -> None:
    with connected(address) as connection:
        connection.sendall(head(5))
        found, headers = answer(connection)
        assert (found, headers["connection"]) == (401, "close")


@pytest.mark.parametrize(("status", "first"), [(408, "answer"), (415, "wait")])
def test_a_body_that_was_refused_for_being_slow_is_not_waited_for(status: int, first: str) -> None:
    """Before the answer; behind it as much is read as of any other."""
    order: list[str] = []

    async def refuses(_: Any, __: Any, send: Any) -> None:
        await send({"type": "http.response.start", "status": status, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def receive() -> dict[str, Any]:
        order.append("wait")
        return {"type": "http.request", "body": b"12345", "more_body": False}

    async def send(message: dict[str, Any]) -> None:
        order.append("answer" if message["type"] == "http.response.start" else "end")

    scope = {"type": "http", "headers": [(b"content-length", b"5")]}
    anyio.run(BodyLeft(refuses, ShutdownDeadline()), scope, receive, send)
    assert order[0] == first
    assert "wait" in order


def test_who_asks_before_sending_is_told_at_once(address: tuple[str, int]) -> None:
    """It is told not to continue, and then why."""
    with connected(address) as connection:
        connection.sendall(head(5, Expect="100-continue"))
        found, headers = answer(connection)
        assert (found, headers["connection"]) == (401, "close")
        assert connection.recv(1) == b""
