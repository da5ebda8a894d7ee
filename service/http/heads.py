"""Requirements of HTTP/1.1 on request heads that the server does not check."""

from __future__ import annotations

import re
from urllib.parse import unquote

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ..errors import MalformedRequest
from ..problem_document import of_error
from . import problems

_ABSOLUTE = re.compile(rb"https?://(?:[^/@]*@)?([^/@]+)(/.*)?", re.IGNORECASE)


class Heads:
    """ASGI middleware: a request target in absolute form (RFC 9112 section 3.2.2) is split into path and host. A
    request with both Content-Length and Transfer-Encoding (section 6.3) is refused, as a sign of request smuggling."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            if found := _ABSOLUTE.fullmatch(scope.get("raw_path") or b""):
                scope["raw_path"] = found[2] or b"/"
                scope["path"] = unquote(scope["raw_path"].decode("ascii"))
                scope["headers"] = [(b"host", found[1]), *(each for each in scope["headers"] if each[0] != b"host")]
            headers = Headers(scope=scope)
            if "transfer-encoding" in headers and "content-length" in headers:
                error = MalformedRequest(
                    "the request has both Content-Length and Transfer-Encoding",
                    field="Content-Length",
                    cure="send one of them",
                )
                await problems.response(of_error(error), {"Connection": "close"})(scope, receive, send)
                return
        await self._app(scope, receive, send)
