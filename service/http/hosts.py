"""Protection against names that others made to lead to the service (DNS rebinding), where its own names are listed."""

from __future__ import annotations

from collections.abc import Iterable

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from ..addresses import host_name
from ..errors import HostRefused
from ..problem_document import of_error
from . import problems

PROBES = ("/healthz", "/readyz")  # orchestrators ask by address


class KnownHosts:
    """ASGI middleware: 421 for requests whose `Host` is none of `hosts`, whatever its port; probes pass.

    To a browser, a page whose name was made to lead to this address is of the same origin as the service.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str]) -> None:
        self._app, self._hosts = app, {host_name(host) for host in hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in PROBES:
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).getlist("host")
        name = host_name(given[0]) if len(given) == 1 else None
        if name is not None and name in self._hosts:
            await self._app(scope, receive, send)
            return
        error = HostRefused(
            f"the service does not answer as {', '.join(given)[:100] or 'a host without a name'}",
            field="Host",
            cure="list the name in GAPMES_ALLOWED_HOSTS; a proxy in front of the service must pass on its Host",
        )
        await problems.response(of_error(error))(scope, receive, send)
