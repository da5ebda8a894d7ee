"""Limits on the size of request bodies, single and together, counted as bytes arrive; and safe parsing of JSON."""

from __future__ import annotations

import json
from typing import Any

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import MalformedRequest, ServiceBusy, UploadTooLarge
from ..problem_document import of_error
from ..unique_members import CURE, RepeatedMember, parsed
from . import problems

SETTING = "GAPMES_MAX_UPLOAD_BYTES"
# Cures for a body that is too large, by path.
CURES = dict.fromkeys(
    ("/reconstruct", "/check"),
    f"send smaller photographs; anything above the model's size is scaled down anyway. Or raise {SETTING}",
) | {"/scenes": f"send a .spz or .compressed.ply, which have fewer bytes, or raise {SETTING}"}
RELEASE = "gapmes.release"  # key in a request's scope: a function to call once its body is freed


class BodyLimit:
    """ASGI middleware: 413 for bodies of more than `max_bytes`, before reading if Content-Length tells, else as soon as
    the limit is passed.

    The bodies of all requests together, from their first byte until they are released or answered, have at most
    `most_together` bytes; one more is refused with 503, but a single body may be larger.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, most_together: int) -> None:
        self.app = app
        self.max_bytes, self.most_together = max_bytes, most_together
        self._held = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        declared = Headers(scope=scope).get("content-length", "0")
        if declared.isascii() and declared.isdigit() and int(declared) > self.max_bytes:
            answer = problems.response(of_error(self._error(int(declared), scope)))
            await answer(scope, receive, send)
            return
        received = held = 0

        async def counted() -> Message:
            nonlocal received, held
            message = await receive()
            size = len(message.get("body", b""))
            received += size
            if received > self.max_bytes:
                raise self._error(received, scope)
            others = self._held - held
            if others and others + held + size > self.most_together:
                raise ServiceBusy(
                    f"{others} bytes of other requests are in memory, with this one the limit of {self.most_together} "
                    "would be passed",
                    field="body",
                    cure="retry later",
                )
            held += size
            self._held += size
            return message

        def release() -> None:
            nonlocal held
            self._held -= held
            held = 0

        scope[RELEASE] = release
        try:
            await self.app(scope, counted, send)
        finally:
            release()

    def _error(self, size: int, scope: Scope) -> UploadTooLarge:
        return UploadTooLarge(
            f"the request has {size} bytes or more, the limit is {self.max_bytes}",
            field="body",
            cure=CURES.get(scope.get("path", ""), f"send less, or raise {SETTING}"),
        )


def parse_json(text: str | bytes, field: str) -> Any:
    """Parse JSON; NaN and Infinity are accepted, since the checks of cameras name them. Raises `MalformedRequest`, for
    repeated members too.

    Integers of more than 15 digits become floats, so that none overflows silently later.
    """
    try:
        return parsed(text, lambda digits: int(digits) if len(digits) <= 15 else float(digits))
    except UnicodeDecodeError as error:
        raise MalformedRequest("is not UTF-8 text", field=field, cure="send JSON as UTF-8") from error
    except json.JSONDecodeError as error:
        raise MalformedRequest(
            f"is not JSON: {error.msg} at line {error.lineno}, column {error.colno}", field=field
        ) from error
    except RepeatedMember as error:
        raise MalformedRequest(str(error), field=field, cure=CURE) from error
    except RecursionError as error:
        raise MalformedRequest("is nested too deeply", field=field) from error
