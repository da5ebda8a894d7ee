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

from ..errors import ServiceBusy

CHUNK = 256 * 2**10  # bytes of an answer that are in memory at a time
MOST = 4 * 2**30  # bytes of all answers of a process, eight of the largest scenes; one that is alone may have more


class _Held:
    """How many bytes the files have that are not sent yet."""

    def __init__(self) -> None:
        self.bytes = 0
        self._lock = threading.Lock()

    def take(self, size: int) -> None:
        """Raises `ServiceBusy` where that is too much beside the others."""
        with self._lock:
            if self.bytes and self.bytes + size > MOST:
                raise ServiceBusy(
                    f"{self.bytes} bytes of other answers are not read yet, with this one's {size} the limit of {MOST} "
                    "would be passed",
                    cure="retry later",
                )
            self.bytes += size

    def give(self, size: int) -> None:
        with self._lock:
            self.bytes -= size


_held = _Held()


def spilled(data: bytes, folder: Path) -> IO[bytes]:
    """The bytes in an unnamed temporary file in `folder`, or in memory if the disk is full. Raises `ServiceBusy` where
    the files of others that are not sent yet leave no room."""
    held = _held
    held.take(len(data))
    try:
        file = _written(data, folder)
    except BaseException:
        held.give(len(data))
        raise
    weakref.finalize(file, held.give, len(data)).atexit = False  # sent, or its client has left
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


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        while piece := file.read(CHUNK):
            yield piece
