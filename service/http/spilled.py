"""Large answers in temporary files while they are sent, so that slow clients keep no memory occupied."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from fastapi.responses import StreamingResponse

CHUNK = 256 * 2**10  # bytes of an answer that are in memory at a time


def spilled(data: bytes, folder: Path) -> IO[bytes]:
    """The bytes in an unnamed temporary file in `folder`, or in memory if the disk is full."""
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
