"""All errors as RFC 9457 problem documents, including those of the framework and unexpected ones."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import GapmesError
from ..problem_document import of_error, problem, public
from ..process.disk import NO_FILE, no_further_file
from ..process.logs import OVER_LIMIT
from .observe import METHODS, shown

MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 2  # a reconstruction with the small networks takes about this long

# Codes for errors of the framework; other statuses become `http_<status>`.
FRAMEWORK_CODES = {404: "route_not_found", 405: "method_not_allowed"}

# Declared by every route in its `responses` for the OpenAPI document.
_DESCRIPTION: dict[str, Any] = {
    "description": "problem document (RFC 9457)",
    "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
RESPONSES: dict[int | str, dict[str, Any]] = {"4XX": _DESCRIPTION, "5XX": _DESCRIPTION}

FORM_PLACE = "body"  # first part of the place of an error in a form
_log = logging.getLogger("gapmes")


def response(document: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> Response:
    body = json.dumps(document, allow_nan=False)  # ASCII, so that no lone surrogate in a file name can break it
    headers = {"X-Gapmes-Problem": document["code"], **(headers or {})}
    return Response(body, status_code=int(document["status"]), media_type=MEDIA_TYPE, headers=headers)


def install(app: FastAPI) -> None:
    """Register handlers that make every error of the application a problem document."""
    app.exception_handler(GapmesError)(_own)
    app.exception_handler(RequestValidationError)(_validation)
    app.exception_handler(HTTPException)(_framework)
    app.exception_handler(ClientDisconnect)(_gone)
    app.exception_handler(Exception)(_unexpected)


async def _own(request: Request, error: GapmesError) -> Response:
    if error.status == 500:  # its message may name paths and libraries: for the log only
        _log.error("%s %s failed", request.method, shown(request.scope["path"]), exc_info=error)
    return of_document(public(error))


def of_document(document: Mapping[str, Any]) -> Response:
    """The response with a problem document, and Retry-After for status 503."""
    return response(document, {"Retry-After": str(RETRY_AFTER_S)} if document["status"] == 503 else None)


async def _validation(request: Request, error: RequestValidationError) -> Response:
    """A document about the first invalid parameter; `errors` lists all."""
    found = error.errors()
    errors = [
        {"field": ".".join(str(part) for part in item["loc"][1:])[:100], "detail": _detail(item)} for item in found
    ]
    first = errors[0]
    cure = _known(request, found[0]["loc"][0]) if found[0]["type"] == "extra_forbidden" else None
    extra = {"errors": errors}
    return response(problem(422, "parameter_invalid", first["detail"], field=first["field"], cure=cure, extra=extra))


def _detail(item: Mapping[str, Any]) -> str:
    """The value that was sent, and what is needed."""
    if item["type"] == "extra_forbidden":
        return f"is not a {'field' if item['loc'][0] == FORM_PLACE else 'parameter'} of this route"
    need = str(item["msg"])
    return need if item["type"] == "missing" else f"is {str(item['input'])[:100]!r}: {need[:1].lower()}{need[1:]}"


def _known(request: Request, place: str) -> str:
    """The route's query parameters, or the fields of its form, from the OpenAPI document."""
    paths, route = request.app.openapi()["paths"], request.scope["route"]
    operation = paths.get(route.path_format, {}).get(request.method.lower(), {})
    if place == FORM_PLACE:
        fields = operation["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
        return f"fields: {', '.join(fields)}"
    listed = [parameter["name"] for parameter in operation.get("parameters", ()) if parameter["in"] == "query"]
    return f"parameters: {', '.join(listed)}"


async def _framework(request: Request, error: HTTPException) -> Response:
    code = FRAMEWORK_CODES.get(error.status_code, f"http_{error.status_code}")
    path, headers = request.scope["path"], dict(error.headers or {})
    if error.status_code == 404:
        detail, cure = f"nothing is served at {shown(path)}", "GET /openapi.json lists the routes"
        if path.endswith("/") and _offered(request, path.rstrip("/")):
            cure = f"leave out the slash at the end: {shown(path.rstrip('/'))}"
    elif error.status_code == 405:
        detail, cure = f"{request.method[:20]} is not offered at {shown(path)}", "the Allow header lists what is"
        headers["Allow"] = ", ".join(_offered(request, path))
    else:
        detail, cure = str(error.detail) or HTTPStatus(error.status_code).phrase, None
    return response(problem(error.status_code, code, detail, cure=cure), headers)


def _offered(request: Request, path: str) -> list[str]:
    """Methods that routes offer at a path."""
    base = {"type": "http", "path": path, "root_path": request.scope.get("root_path", ""), "headers": []}
    routes = request.app.routes
    return [
        method
        for method in METHODS
        if any(route.matches({**base, "method": method})[0] is Match.FULL for route in routes)
    ]


async def _gone(_: Request, __: ClientDisconnect) -> Response:
    """A response that nobody reads: it keeps a broken upload from being logged as an internal error."""
    return response(problem(400, "client_disconnected", "the request ended before its body was complete"))


class FaultsAnswered:
    """ASGI middleware: answers unexpected exceptions inside the CORS middleware, so that pages of allowed origins can
    read the answer. Once an answer has begun, the exception is raised to the framework."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun = False

        async def watched(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, watched)
        except Exception as error:
            if begun or scope["type"] != "http":
                raise
            answer = await _unexpected(Request(scope), error)
            await answer(scope, receive, send)


async def _unexpected(request: Request, error: Exception) -> Response:
    """500 without internals, and the traceback in the log; 503 if the process has too many open files."""
    if isinstance(error, OSError) and error.errno in NO_FILE:
        _log.warning("%s of open files is reached: requests are refused (ulimit -n)", OVER_LIMIT)
        answer = of_document(of_error(no_further_file()))
        answer.headers["Connection"] = "close"
        return answer
    request_id = getattr(request.state, "request_id", None)  # outside of the middleware that adds it to every answer
    path = shown(request.scope["path"])
    _log.error("%s %s failed", request.method, path, exc_info=error, extra={"request_id": request_id})
    headers = {"Connection": "close"}  # part of the body may be unread
    return response(public(error), headers if request_id is None else headers | {"X-Request-ID": request_id})
