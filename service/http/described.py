"""Headers and HEAD operations in the OpenAPI document, derived from the responses that routes declare."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

# Descriptions of response headers.
ANSWERED = {
    "Accept-Ranges": "`bytes` where `Range` is heeded, else `none`",
    "Allow": "with 405: the methods that are offered",
    "Content-Disposition": "a name for the file",
    "Content-Range": "which part this is; with 416 how long the file is",
    "ETag": "names what is sent, for `If-None-Match`",
    "Location": "where the scene or the job is",
    "Preference-Applied": "`respond-async`",
    "Repr-Digest": "the SHA-256 of the whole file in base64, `sha-256=:...:` (RFC 9530)",
    "Retry-After": "with 503: seconds",
    "Server-Timing": "stages of the work with their milliseconds",
    "WWW-Authenticate": "with 401: that the service needs a key",
    "X-Accel-Buffering": "`no`: a proxy passes each event on as it comes",
    "X-Gapmes-Depth-Max": "of `channel=depth`: the largest depth of the picture, in the cameras' units",
    "X-Gapmes-Depth-Min": "of `channel=depth`: the smallest depth of the picture",
    "X-Gapmes-Depth-Offset": "of `channel=depth`: what is added to level x scale",
    "X-Gapmes-Depth-Scale": "of `channel=depth`: units per grey level",
    "X-Gapmes-Notes": "what the format could not hold, a JSON list",
    "X-Gapmes-Problem": "the `code` of the problem document",
    "X-Gapmes-Scene": "id of the scene that was drawn",
    "X-Gapmes-Stats": "what was drawn and what was not, a JSON object",
    "X-Request-ID": "that of the request, or a new one",
}
# Descriptions of request headers.
ASKED = {
    "If-None-Match": "tags that the client has: 304 where one is right",
    "If-Range": "the tag of what `Range` asks a part of; all of it is sent where that has changed",
    "Prefer": "`respond-async`: the answer is a job, at once",
    "Range": "a part of the .ply, `bytes=0-99`; other formats are sent whole",
}
_DEPTH = [name for name in ANSWERED if name.startswith("X-Gapmes-Depth")]
# Response headers of single routes, beside those that follow from their statuses.
OF_ROUTE = {
    "/render": ["X-Gapmes-Scene", "X-Gapmes-Stats", *_DEPTH],
    "/scenes/{scene_id}.{extension}": ["Content-Disposition", "Repr-Digest", "X-Gapmes-Notes"],
    "/reconstruct": ["Content-Disposition", "Repr-Digest"],
    "/jobs/{job_id}/events": ["X-Accel-Buffering"],
}
OF_PART = ["Content-Disposition", "Repr-Digest"]  # only a .ply is sent in parts
FILES = "/scenes/{scene_id}.{extension}"  # has no Server-Timing


def describe(paths: dict[str, Any]) -> None:
    """Add request headers, response headers and HEAD operations to the `paths` of an OpenAPI document."""
    for path, operations in paths.items():
        for operation in operations.values():
            responses = operation["responses"]
            asked = [_parameter(name) for name in ASKED if _asks(name, responses)]
            if asked:
                operation["parameters"] = [*operation.get("parameters", ()), *asked]
            for status, response in responses.items():
                response = responses[status] = dict(response)  # a copy: all routes share the one of errors
                headers = ["X-Request-ID", *_answers(path, status, responses)]
                response["headers"] = {name: _header(name) for name in sorted(headers)}
        if "get" in operations:
            operations["head"] = _head(operations["get"])


def _asks(name: str, responses: Iterable[str]) -> bool:
    needed = {"If-None-Match": "304", "If-Range": "206", "Range": "206", "Prefer": "202"}
    return needed[name] in responses


def _answers(path: str, status: str, responses: Iterable[str]) -> list[str]:
    """Names of the headers of a response, from the statuses of its route."""
    if status == "4XX":
        return ["X-Gapmes-Problem", "Allow", "WWW-Authenticate", *(["Content-Range"] if "206" in responses else [])]
    if status == "5XX":
        return ["X-Gapmes-Problem", "Retry-After"]
    found = ["ETag"] if "304" in responses else []
    if status == "202":
        found += ["Location", "Preference-Applied"]
    if status == "206":
        found += ["Content-Range", *OF_PART]
    if status in ("200", "206") and "206" in responses:
        found += ["Accept-Ranges"]
    if status in ("200", "201") and "201" in responses:
        found += ["Location"]
    if status == "201" or (status == "200" and "304" in responses and path != FILES):
        found += ["Server-Timing"]
    if status in ("200", "201"):
        found += OF_ROUTE.get(path, [])
    return found


def _parameter(name: str) -> dict[str, Any]:
    return {"name": name, "in": "header", "required": False, "description": ASKED[name], "schema": {"type": "string"}}


def _header(name: str) -> dict[str, Any]:
    return {"description": ANSWERED[name], "schema": {"type": "number" if name in _DEPTH else "string"}}


def _head(get: dict[str, Any]) -> dict[str, Any]:
    """The HEAD operation of a GET operation."""
    responses = {
        status: {name: value for name, value in response.items() if name != "content"}
        for status, response in get["responses"].items()
    }
    told = {"operationId": f"{get['operationId']}_head", "description": "As GET, without the body."}
    return get | told | {"responses": responses}
