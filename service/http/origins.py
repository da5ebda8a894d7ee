"""Which web pages may change anything: the service's own, and those of the origins that it is told of."""

from __future__ import annotations

from collections.abc import Collection
from urllib.parse import SplitResult, urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ..errors import OriginRefused
from ..problem_document import of_error
from . import problems

READING = ("GET", "HEAD", "OPTIONS")  # change nothing; a browser keeps their answers from pages of other origins
OWN = ("same-origin", "none")  # what a browser says of the service's own page, and of the user's own doing
ANY = "*"
_PORTS = {"http": 80, "https": 443}


class KnownPages:
    """ASGI middleware: 403 for what a browser sends for a page of another origin, unless it is one of `origins`.

    A form may be posted to any address without a question before, and its answer be hidden, but not its effect. What
    no browser sends passes.
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
        if site is not None:  # no page can set it; it holds where a proxy names another Host than the browser did
            return site in OWN
        return origin is None or _same_host(origin, headers.get("host", ""))


def _same_host(origin: str, host: str) -> bool:
    """Whether both have the same name and port; not the scheme, which a proxy with TLS changes."""
    try:
        page = urlsplit(origin)
        return bool(page.hostname) and _place(page) == _place(urlsplit(f"{page.scheme}://{host}"))
    except ValueError:  # no origin, or no host
        return False


def _place(url: SplitResult) -> tuple[str | None, int | None]:
    return url.hostname, url.port or _PORTS.get(url.scheme)
