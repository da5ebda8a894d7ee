"""Protection against cross-site requests: only the service's own page and configured origins may change anything."""

from __future__ import annotations

from collections.abc import Collection
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ..errors import OriginRefused
from ..problem_document import of_error
from . import problems

READING = ("GET", "HEAD", "OPTIONS")  # change nothing, and browsers hide their answers from other origins
OWN = ("same-origin", "none")  # Sec-Fetch-Site of the service's own page, and of requests by the user
ANY = "*"
_PORTS = {"http": 80, "https": 443}


class KnownPages:
    """ASGI middleware: 403 for requests that a browser sends for a page of another origin, unless in `origins`.

    Browsers send forms to other origins without a preflight request; only the answer is hidden. Requests of other
    clients pass.
    """

    def __init__(self, app: ASGIApp, origins: Collection[str]) -> None:
        self._app, self._origins = app, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] in READING or self._known(Headers(scope=scope)):
            await self._app(scope, receive, send)
            return
        origin = Headers(scope=scope).get("origin", "of another site")
        error = OriginRefused(
            f"the page that sends this, {origin[:100]}, is none of this service",
            field="Origin",
            cure="list its origin in GAPMES_CORS_ORIGINS; a proxy before the service's own page must pass on its Host",
        )
        await problems.response(of_error(error))(scope, receive, send)

    def _known(self, headers: Headers) -> bool:
        origin, site = headers.get("origin"), headers.get("sec-fetch-site")
        if ANY in self._origins or origin in self._origins:
            return True
        if site is not None:  # pages cannot set it, and proxies that change Host do not matter
            return site in OWN
        return origin is None or _same_host(origin, headers.get("host", ""))


def _same_host(origin: str, host: str) -> bool:
    """Whether both have the same host name and port; the scheme may differ behind a TLS proxy."""
    try:
        page = urlsplit(origin)
        return bool(page.hostname) and _place(page) == _place(urlsplit(f"{page.scheme}://{host}"))
    except ValueError:  # malformed
        return False


def _place(url: SplitResult) -> tuple[str | None, int | None]:
    return url.hostname, url.port or _PORTS.get(url.scheme)
