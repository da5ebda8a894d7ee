"""Large answers in temporary files while they are sent, so that slow clients keep no memory occupied; with a limit for
all of them together, so that they do not fill the disk either."""

from __future__ import annotations

import io
import threading
import weakref
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from ..errors import ServiceBusy

CHUNK = 256 * 2**10  # bytes of an answer that are in memory at a time
MOST = 4 * 2**30  # bytes of all answers of a process, eight of the largest scenes; one that is alone may have more


_unsent: weakref.WeakKeyDictionary[IO[bytes], int] = weakref.WeakKeyDictionary()  # files that are open, and their bytes
_counting = threading.Lock()


def spilled(data: bytes, folder: Path) -> IO[bytes]:
    """The bytes in an unnamed temporary file in `folder`, or in memory if the disk is full. Raises `ServiceBusy` where
    the files of other answers leave no room until they are closed."""
    with _counting:
        others = sum(size for file, size in _unsent.items() if not file.closed)
        if others and others + len(data) > MOST:
            raise ServiceBusy(
                f"{others} bytes of other answers are not read yet, with this one's {len(data)} the limit of {MOST} "
                "would be passed",
                cure="retry later",
            )
        place = io.BytesIO()  # counts until the file is written, or writing it fails
        _unsent[place] = len(data)
    file = _written(data, folder)
    with _counting:
        _unsent[file] = _unsent.pop(place)
    return file


def _written(data: bytes, folder: Path) -> IO[bytes]:
    try:
        file = TemporaryFile(dir=folder)  # noqa: SIM115 - the answer closes it
    except OSError:
        return io.BytesIO(data)
    try:
        file.write(data)
        file.flush()
    except OSError:
        with suppress(OSError):
            file.close()
        return io.BytesIO(data)
    file.seek(0)
    return file


class SpilledResponse(StreamingResponse):
    """Streams the file of `spilled` in pieces of `CHUNK` bytes, and closes it."""

    def __init__(self, file: IO[bytes], media_type: str, headers: Mapping[str, str], status_code: int = 200) -> None:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        headers = {**headers, "Content-Length": str(size)}
        super().__init__(_pieces(file), status_code, headers, media_type)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._file.close()  # where the client has left, the next collection of garbage would


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        while piece := file.read(CHUNK):
            yield piece
