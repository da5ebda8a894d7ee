"""Receiving a multipart form within limits, and reading its single fields."""

from __future__ import annotations

import codecs
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

import anyio
from fastapi import Request
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from ..errors import InputError, MalformedRequest, UnsupportedMediaType, UploadTimeout, UploadTooLarge
from ..process.temporary_folder import temporary_files
from ..settings import Settings

FORM = "multipart/form-data"
MAX_IMAGES = 60  # in one request; at most 6 are used. A capture may hold more
MAX_PARTS = MAX_IMAGES + 4  # files, and as many fields; reading stops at one more
MAX_TEXT = 16 * 2**10  # bytes of a text field, far more than 64 views or 6 long names; reading stops beyond
DOCUMENT = "cameras"  # the only long text field, which has a limit of its own
ONCE = {DOCUMENT: "send one of them; a COLMAP model of several files goes in as one zip"}  # cures, by field
# Codecs of Python for names of hosts, which are no charsets; the first takes minutes for half a megabyte.
NO_CHARSETS = ("punycode", "idna")
LONGEST_CHARSET = 40  # characters of its name, twice those of any; Python remembers every unknown one that it has met
# Prefixes of the parsers' messages, which have no codes.
_TOO_MANY_FILES, _LONG_HEADERS = "Too many files", "Maximum header"


def media_type(request: Request) -> str:
    """Media type of the body in lower case, without parameters; empty if none is declared."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def refuse_compressed(request: Request) -> None:
    """Raises `UnsupportedMediaType` for a body with a Content-Encoding (RFC 9110 section 8.4), which is not undone."""
    coding = request.headers.get("content-encoding", "").strip()
    if coding.lower() not in ("", "identity"):
        raise UnsupportedMediaType(
            f"the body is encoded as {coding[:50]!r}, need none", field="Content-Encoding", cure="send it as it is"
        )


def no_file(part: str | None, field: str, example: str, index: int | None = None) -> InputError:
    """The error for a field that must be a file part, with a command that sends one."""
    what = "is missing" if part is None else "is a text field, need a file part"
    hint = "" if part is None else ", with `filename=` in its Content-Disposition, not only `filename*=`"
    return InputError(what, field=field, index=index, cure=f"{example}{hint}")


@asynccontextmanager
async def posted_form(
    request: Request, settings: Settings, example: str, too_many: InputError
) -> AsyncIterator[FormData]:
    """The form of a request, whose files are closed after the block, without the empty parts that browsers send for
    file inputs where no file was chosen. A query beside the form is refused. Raises errors of our own only, never the
    framework's.

    `example` is a command that sends such a form; `too_many` is raised for more than `MAX_PARTS` files.
    """
    refuse_compressed(request)
    if media_type(request) != FORM:
        declared = request.headers.get("content-type", "")
        raise UnsupportedMediaType(
            f"the body is {declared[:100] or 'of no declared type'}, need {FORM}", field="body", cure=example
        )
    _check_charset(request.headers["content-type"])
    if request.query_params:
        field = next(iter(request.query_params))[:100]
        raise InputError("is in the query beside a form", field=field, cure="make it a field of the form")
    try:
        with in_time(settings), temporary_files("the upload"):
            form = await _Parser(
                request.headers,
                request.stream(),
                max_files=MAX_PARTS,
                max_fields=MAX_PARTS,
                max_part_size=settings.max_upload_bytes,
            ).parse()
    except MultiPartException as error:
        if error.message.startswith(_TOO_MANY_FILES):
            raise too_many from error
        if error.message.startswith(_LONG_HEADERS):
            raise MalformedRequest(
                f"a part of the form has too long or too many headers: {error.message}",
                field="body",
                cure="shorten the file's name; a part needs no headers but Content-Disposition and Content-Type",
            ) from error
        raise MalformedRequest(f"the multipart body cannot be read: {error.message}", field="body") from error
    except UnicodeError as error:
        raise MalformedRequest("names are not in the body's declared charset", field="body") from error
    try:
        yield FormData([(name, part) for name, part in form.multi_items() if not _unselected(part)])
    finally:
        await form.close()


def _unselected(part: UploadFile | str) -> bool:
    """Whether a browser sent this part for a file input without a file: it has neither a file name nor contents."""
    return isinstance(part, UploadFile) and not part.filename and not part.size


def _check_charset(content_type: str) -> None:
    """Raises `MalformedRequest` for a form's charset whose name is that of none."""
    charset = parse_options_header(content_type)[1].get(b"charset", b"utf-8").decode("latin-1")
    message = None
    if len(charset) > LONGEST_CHARSET:
        message = f"its charset has a name of {len(charset)} characters, need at most {LONGEST_CHARSET}"
    else:
        with suppress(LookupError):  # of an unknown one, which the framework answers
            name = codecs.lookup(charset).name  # with spaces around it, too
            message = f"its charset is {name}, need one of text" if name in NO_CHARSETS else None
    if message is not None:
        raise MalformedRequest(message, field="Content-Type", cure="leave it out: UTF-8")


class _Parser(MultiPartParser):
    """The framework's parser, with a limit on text fields as they arrive. A form without its closing boundary is
    refused, since its last field would be lost silently."""

    _whole = False

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        part = self._current_part
        if part.file is None and part.field_name != DOCUMENT and len(part.data) + end - start > MAX_TEXT:
            raise UploadTooLarge(
                f"is a text field of more than {MAX_TEXT} bytes",
                field=part.field_name[:100],
                cure="send less; a file is a part with a file name",
            )
        super().on_part_data(data, start, end)

    def on_end(self) -> None:
        self._whole = True
        super().on_end()

    async def parse(self) -> FormData:
        try:
            form = await super().parse()
        except BaseException as error:
            for file in self._files_to_close_on_error:  # earlier releases of the framework do not for all errors
                with suppress(OSError):
                    file.close()
            cause = error if isinstance(error, FormParserError) else error.__cause__
            if isinstance(cause, FormParserError):  # later releases hide the message
                raise MultiPartException(str(cause)) from error
            raise
        if not self._whole:
            await form.close()
            raise MultiPartException("it ends before its closing boundary")
        return form


@contextmanager
def in_time(settings: Settings) -> Iterator[None]:
    """Raises `UploadTimeout` if the block takes more than `upload_seconds`."""
    try:
        with anyio.fail_after(settings.upload_seconds):
            yield
    except TimeoutError as error:
        raise UploadTimeout(
            f"did not arrive within {settings.upload_seconds:g} s", field="body", cure="send smaller files"
        ) from error


def text(form: FormData, name: str) -> str:
    """A text field without surrounding spaces; empty if missing. Raises `InputError` for a file part."""
    part = single(form, name)
    if isinstance(part, UploadFile):
        raise InputError("is a file part, need a text field", field=name)
    return (part or "").strip()


def size_of(part: UploadFile | str) -> int:
    """Bytes of a part, of a text field in UTF-8."""
    return (part.size or 0) if isinstance(part, UploadFile) else len(part.encode("utf-8", "surrogatepass"))


def single(form: FormData, name: str) -> UploadFile | str | None:
    """A field or file that may be given once; None if missing. Raises `InputError`."""
    parts = form.getlist(name)
    if len(parts) > 1:
        raise InputError(f"is given {len(parts)} times, need once", field=name, cure=ONCE.get(name, "send it once"))
    return parts[0] if parts else None
