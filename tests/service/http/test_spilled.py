"""Large answers are on disk while they are sent: complete, in pieces, without a name, and in memory if the disk is
full."""

from __future__ import annotations

import errno
import io
import os
import resource
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import anyio
import pytest

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
    monkeypatch.setattr(module, "_held", module._Held())


@pytest.mark.usefixtures("room")
def test_answers_that_nobody_goes_on_reading_have_a_limit_together(tmp_path: Path) -> None:
    """A client that reads slowly keeps one for days: some dozens filled the disk with copies of one scene."""
    first, second = spilled(DATA, tmp_path), spilled(DATA, tmp_path)
    words = f"{2 * len(DATA)} bytes of other answers are not read yet, with this one's {len(DATA)} the limit"
    with pytest.raises(ServiceBusy, match=words):
        spilled(DATA, tmp_path)
    assert len(b"".join(sent(SpilledResponse(first, "application/octet-stream", {})))) == len(DATA)
    del first
    third = spilled(DATA, tmp_path)
    del second, third
    assert module._held.bytes == 0


@pytest.mark.usefixtures("room")
def test_one_that_is_alone_may_be_larger(tmp_path: Path) -> None:
    file = spilled(3 * DATA, tmp_path)
    with pytest.raises(ServiceBusy):
        spilled(b"x", tmp_path)
    del file
    assert spilled(b"x", tmp_path).read() == b"x"


@pytest.mark.usefixtures("room")
def test_what_cannot_be_written_is_not_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(**_: object) -> object:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "TemporaryFile", interrupted)
    with pytest.raises(KeyboardInterrupt):
        spilled(DATA, tmp_path)
    assert module._held.bytes == 0
