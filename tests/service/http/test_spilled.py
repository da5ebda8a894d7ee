"""Large answers are on disk while they are sent: complete, in pieces, without a name, and in memory if the disk is
full."""

from __future__ import annotations

import errno
import io
import os
import resource
import signal
import weakref
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import anyio
import pytest
from starlette.types import Message

from gapmes.service.errors import ServiceBusy
from gapmes.service.http import spilled as module
from gapmes.service.http.spilled import CHUNK, SpilledResponse, spilled

DATA = os.urandom(2 * CHUNK + 5)


def sent(response: SpilledResponse) -> list[bytes]:
    async def pieces() -> list[bytes]:
        body: AsyncIterator[Any] = response.body_iterator  # type: ignore[assignment]
        return [piece async for piece in body]

    return anyio.run(pieces)


def test_it_is_sent_in_pieces_and_leaves_nothing(tmp_path: Path) -> None:
    file = spilled(DATA, tmp_path)
    assert not list(tmp_path.iterdir())  # no name, so that nothing stays after a kill
    assert os.fstat(file.fileno()).st_size == len(DATA)
    response = SpilledResponse(file, "application/octet-stream", {"ETag": '"x"'}, 201)
    assert response.headers["content-length"] == str(len(DATA))
    assert (response.status_code, response.headers["etag"]) == (201, '"x"')
    pieces = sent(response)
    assert [len(piece) for piece in pieces] == [CHUNK, CHUNK, 5]
    assert b"".join(pieces) == DATA
    assert file.closed


def test_a_disk_that_is_full_at_the_end_is_full(tmp_path: Path) -> None:
    """As the kernel says it: the last bytes of a file are written when it is flushed."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(DATA) - 2, before[1]))
        file = spilled(DATA, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert isinstance(file, io.BytesIO)
    assert file.read() == DATA


def test_where_the_disk_is_full_it_is_sent_from_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> object:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module, "TemporaryFile", full)
    assert b"".join(sent(SpilledResponse(spilled(DATA, tmp_path), "application/octet-stream", {}))) == DATA


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> None:
    """For two answers of DATA and a half."""
    monkeypatch.setattr(module, "MOST", 5 * len(DATA) // 2)
    monkeypatch.setattr(module, "_unsent", weakref.WeakKeyDictionary())


@pytest.mark.usefixtures("room")
def test_answers_that_nobody_goes_on_reading_have_a_limit_together(tmp_path: Path) -> None:
    """A client that reads slowly keeps one for days: some dozens filled the disk with copies of one scene."""
    first, second = spilled(DATA, tmp_path), spilled(DATA, tmp_path)
    words = f"{2 * len(DATA)} bytes of other answers are not read yet, with this one's {len(DATA)} the limit"
    with pytest.raises(ServiceBusy, match=words):
        spilled(DATA, tmp_path)
    assert len(b"".join(sent(SpilledResponse(first, "application/octet-stream", {})))) == len(DATA)
    spilled(DATA, tmp_path).close()
    second.close()


@pytest.mark.usefixtures("room")
def test_one_that_is_alone_may_be_larger(tmp_path: Path) -> None:
    with spilled(3 * DATA, tmp_path), pytest.raises(ServiceBusy):
        spilled(b"x", tmp_path)
    with spilled(b"x", tmp_path) as file:
        assert file.read() == b"x"


@pytest.mark.usefixtures("room")
def test_one_that_is_being_written_has_its_place_already(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of several threads would find room, and all of them together pass the limit; one that fails takes none."""
    write = module._written

    def written(data: bytes, folder: Path) -> Any:
        monkeypatch.setattr(module, "_written", write)
        with pytest.raises(ServiceBusy, match=f"{2 * len(DATA)} bytes of other answers"):
            spilled(DATA, folder)
        return write(data, folder)

    def failing(data: bytes, folder: Path) -> Any:
        raise MemoryError

    monkeypatch.setattr(module, "_written", failing)
    with pytest.raises(MemoryError):
        spilled(DATA, tmp_path)
    monkeypatch.setattr(module, "_written", written)
    with spilled(2 * DATA, tmp_path) as file:
        assert file.read() == 2 * DATA
    assert not any(not open_file.closed for open_file in module._unsent)


def test_the_file_is_closed_as_soon_as_its_client_has_left(tmp_path: Path) -> None:
    """Not when garbage is next collected, which a service that has nothing to do does not."""
    response = SpilledResponse(spilled(DATA, tmp_path), "application/octet-stream", {})
    file = response._file

    async def send(message: Message) -> None:
        if message.get("body"):
            raise OSError(errno.ECONNRESET, "Connection reset by peer")

    async def receive() -> Message:
        await anyio.sleep_forever()
        raise AssertionError

    with pytest.raises(Exception):  # noqa: B017, PT011  the framework's, of either age
        anyio.run(response, {"type": "http", "asgi": {"spec_version": "2.4"}}, receive, send)
    assert file.closed
