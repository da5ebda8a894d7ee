"""Middleware around every request: id, access log, metrics and common headers."""

from __future__ import annotations

import logging
import re
import time
import uuid
from urllib.parse import quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..metrics import REJECTED, REQUESTS, SECONDS
from ..process.logs import REQUEST_ID

HEADER = "X-Request-ID"
JOB = "job"  # key in a request's state: id of the job that it submitted or joined
QUIET = ("/healthz", "/readyz", "/metrics")  # polled every few seconds: counted, but not logged
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
_ID = re.compile(r"[\w.:-]{1,64}", re.ASCII)
SHOWN = 200  # characters of a path that are logged; no existing route has more
_log = logging.getLogger("gapmes.access")


class Observed:
    """ASGI middleware; a well-formed X-Request-ID of the client is kept."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        brought = Headers(scope=scope).get(HEADER, "")
        request_id = brought if _ID.fullmatch(brought) else uuid.uuid4().hex
        token = REQUEST_ID.set(request_id)
        scope.setdefault("state", {})["request_id"] = request_id
        start, status, sent = time.perf_counter(), 0, 0

        async def watched(message: Message) -> None:
            nonlocal status, sent
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers[HEADER] = request_id
                headers.setdefault("X-Content-Type-Options", "nosniff")
                code = headers.get("X-Gapmes-Problem")
                if code is not None:
                    REJECTED.labels(code).inc()
            elif message["type"] == "http.response.body":
                sent += len(message.get("body", b""))
            await send(message)

        try:
            await self._app(scope, receive, watched)
        except Exception:
            status = 500  # the answer comes from an outer middleware
            raise
        finally:
            seconds = time.perf_counter() - start
            method = scope["method"] if scope["method"] in METHODS else "other"
            route = getattr(scope.get("route"), "path", "none")
            REQUESTS.labels(method, route, status).inc()
            SECONDS.labels(route).observe(seconds)
            if scope["path"] not in QUIET:
                told = {"seconds": round(seconds, 4), "bytes": sent, "route": route}
                if JOB in scope["state"]:
                    told["job"] = scope["state"][JOB]
                _log.info("%s %s %d", method, shown(scope["path"]), status, extra=told)
            REQUEST_ID.reset(token)


def shown(path: str) -> str:
    """The beginning of a path, percent-encoded so that control characters cannot forge lines of the log."""
    return quote(path[:SHOWN], safe="/:")
