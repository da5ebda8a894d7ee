"""The bound on a request's body, counted as the bytes arrive, and JSON parsing that no document can upset."""

from __future__ import annotations

import json
from typing import Any

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import MalformedRequest, UploadTooLarge
from ..problem_document import of_error
from . import problems


class BodyLimit:
    """ASGI middleware: a declared length over the limit is refused unread, an undeclared one where it crosses it."""

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self.app = app
        self.max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        declared = Headers(scope=scope).get("content-length", "0")
        if declared.isascii() and declared.isdigit() and int(declared) > self.max_bytes:
            answer = problems.response(of_error(self._error(int(declared))), {"Connection": "close"})
            await answer(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self.max_bytes:
                raise self._error(received)
            return message

        await self.app(scope, counted, send)

    def _error(self, size: int) -> UploadTooLarge:
        return UploadTooLarge(
            f"the request has {size} bytes or more, the limit is {self.max_bytes}",
            field="body",
            cure="send smaller photographs; anything above the model's size is scaled down anyway",
        )


def parse_json(text: str | bytes, field: str) -> Any:
    """Parse JSON; NaN and Infinity pass (the camera's checks name them), anything malformed is a `MalformedRequest`.

    Whole numbers beyond 15 digits become floats, so that none can overflow later without a word.
    """
    try:
        return json.loads(text, parse_int=lambda digits: int(digits) if len(digits) <= 15 else float(digits))
    except UnicodeDecodeError as error:
        raise MalformedRequest("is not UTF-8 text", field=field, cure="send JSON as UTF-8") from error
    except json.JSONDecodeError as error:
        raise MalformedRequest(
            f"is not JSON: {error.msg} at line {error.lineno}, column {error.colno}", field=field
        ) from error
    except RecursionError as error:
        raise MalformedRequest("is nested too deeply", field=field) from error
