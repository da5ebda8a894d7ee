"""Successful responses: JSON, HEAD, Server-Timing, and content negotiation by Accept headers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from fastapi import Response

from ..errors import NotAcceptable
from ..formats.registry import MEDIA_TYPE
from ..plain_number import plain_float

JSON = "application/json"
PLY = MEDIA_TYPE
ZIP = "application/zip"
OFFERED = (JSON, PLY, ZIP)


def json_response(content: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    body = json.dumps(content, allow_nan=False)  # ASCII, so that no lone surrogate in a file name can break it
    return Response(body, status_code=status, media_type=JSON, headers=dict(headers or {}))


def head_alone(media_type: str, headers: Mapping[str, str]) -> Response:
    """A response to HEAD without Content-Length, as the body is not made for it."""
    answer = Response(media_type=media_type, headers=dict(headers))
    del answer.headers["content-length"]
    return answer


def server_timing(seconds: Mapping[str, float]) -> str:
    """The value of a Server-Timing header: stages with their durations in ms."""
    names = {name.replace(" ", "-"): 1000 * value for name, value in seconds.items()}
    return ", ".join(f"{name};dur={value:.1f}" for name, value in names.items())


def accepted(header: str | None) -> str:
    """The offered media type with the highest weight in an Accept header; ties go to the first one offered.

    A type has the weight of the most specific range that covers it (RFC 9110 section 12.5.1); a malformed weight is
    ignored. Raises `NotAcceptable` if all weights are zero.
    """
    if not header or not header.strip():
        return JSON
    ranges = _weights(header)
    weights = {offer: _weight_of(offer, ranges) for offer in OFFERED}
    best = max(OFFERED, key=lambda offer: weights[offer])
    if weights[best] <= 0:
        raise NotAcceptable(f"{header[:100]!r} accepts none of {', '.join(OFFERED)}", field="Accept")
    return best


def takes_gzip(header: str) -> bool:
    """Whether an Accept-Encoding header (RFC 9110 section 12.5.3) allows gzip."""
    weights = _weights(header)
    return next((weights[name] for name in ("gzip", "x-gzip", "*") if name in weights), 0.0) > 0


def _weights(header: str) -> dict[str, float]:
    """Weights of the items of a header, by name in lower case."""
    weights: dict[str, float] = {}
    for item in header.split(","):
        name, *parameters = (part.strip().lower() for part in item.split(";"))
        weights[name] = max(weights.get(name, 0.0), _weight(parameters))
    return weights


def _weight_of(offer: str, ranges: Mapping[str, float]) -> float:
    for media_range in (offer, "application/*", "*/*"):
        if media_range in ranges:
            return ranges[media_range]
    return 0.0


def _weight(parameters: list[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                weight = plain_float(value)
            except ValueError:
                return 1.0
            return weight if 0 <= weight <= 1 else 1.0
    return 1.0
