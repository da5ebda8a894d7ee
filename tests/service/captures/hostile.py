"""Helpers of the tests of harmful captures: archives built by hand, and a bound on memory."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager

from gapmes.service.captures.archive import ZipFiles


def archive_of(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as made:
        for name, data in members:
            made.writestr(zipfile.ZipInfo(name), data, method)
    return buffer.getvalue()


@contextmanager
def peak_below(limit: int) -> Iterator[None]:
    """The allocations inside never exceed so many bytes at one time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


def opened(data: bytes, **options: int) -> ZipFiles:
    return ZipFiles(io.BytesIO(data), **options)
