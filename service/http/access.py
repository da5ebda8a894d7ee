"""Authentication by an API key, if one is configured. Health probes and the page's own files need none."""

from __future__ import annotations

import hmac

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ..errors import Unauthorized
from ..problem_document import of_error
from . import problems

OPEN = ("/healthz", "/readyz", "/", "/viewer", "/docs")  # and the files of the page, which hold no data
OPEN_BELOW = "/static/"
SCHEME = "bearer "
# Security schemes of the OpenAPI document.
SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer"},
    "key": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
}


class KeyNeeded:
    """ASGI middleware: 401 for requests without `Authorization: Bearer KEY` or `X-API-Key: KEY`."""

    def __init__(self, app: ASGIApp, key: str) -> None:
        self._app, self._key = app, key.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or _open(scope["path"]) or self._brought(Headers(scope=scope)):
            await self._app(scope, receive, send)
            return
        error = Unauthorized("this service needs a key", field="Authorization", cure="Authorization: Bearer KEY")
        headers = {"WWW-Authenticate": 'Bearer realm="gapmes"'}
        await problems.response(of_error(error), headers)(scope, receive, send)

    def _brought(self, headers: Headers) -> bool:
        """Either header suffices: the other may be meant for a proxy."""
        given = headers.get("authorization", "")
        bearer = given[len(SCHEME) :] if given.lower().startswith(SCHEME) else ""
        keys = [key.encode("latin-1") for key in (bearer, headers.get("x-api-key", ""))]  # the bytes of the headers
        return any([hmac.compare_digest(key, self._key) for key in keys])


def _open(path: str) -> bool:
    return path in OPEN or path.startswith(OPEN_BELOW)
