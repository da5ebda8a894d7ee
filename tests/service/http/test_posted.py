"""The parser of posted forms, with any release of the framework: ending it early closes its files."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from tempfile import SpooledTemporaryFile

import pytest
from python_multipart.exceptions import MultipartParseError
from starlette.datastructures import FormData, Headers
from starlette.formparsers import MultiPartException, MultiPartParser

from gapmes.service.errors import UploadTooLarge
from gapmes.service.http.posted import _Parser


async def _nothing() -> AsyncIterator[bytes]:
    yield b""


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (MultipartParseError("no boundary at index 3"), MultiPartException),
        (MultiPartException("Too many fields"), MultiPartException),
        (UploadTooLarge("is long"), UploadTooLarge),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "odd"), UnicodeError),
        (asyncio.CancelledError(), asyncio.CancelledError),
    ],
)
def test_what_ends_the_parser_early_closes_its_files(
    error: BaseException, raised: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The framework's own parser, which here leaves files as they are, as its earlier releases do."""
    file: SpooledTemporaryFile[bytes] = SpooledTemporaryFile()  # noqa: SIM115 - the parser closes it

    async def fail(parser: MultiPartParser) -> FormData:
        parser._files_to_close_on_error.append(file)
        raise error

    monkeypatch.setattr(MultiPartParser, "parse", fail)
    with pytest.raises(raised) as told:
        asyncio.run(_Parser(Headers(), _nothing()).parse())
    assert file.closed
    if raised is MultiPartException:
        assert isinstance(told.value, MultiPartException)
        assert told.value.message == (error.message if isinstance(error, MultiPartException) else str(error))
