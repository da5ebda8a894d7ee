"""What an RFC 9457 problem document says: type, title, status, detail, and our code, field, index and cure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from .errors import GapmesError

_OURS = "this is a fault of the service; its log has the details"


def problem(
    status: int,
    code: str,
    detail: str,
    *,
    field: str | None = None,
    index: int | None = None,
    cure: str | None = None,
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The document's members; absent ones are left out. `title` is the code in words, the same for every occurrence."""
    document = {
        "type": f"urn:gapmes:problem:{code}",
        "title": code.replace("_", " ").capitalize(),
        "status": status,
        "detail": detail,
        "code": code,
        "field": field,
        "index": index,
        "cure": cure,
    }
    members = {name: value for name, value in document.items() if value is not None}
    return {**plain(dict(extra or {})), **members}


def of_error(error: GapmesError) -> dict[str, Any]:
    """The document of one of our own errors."""
    return problem(
        error.status,
        error.code,
        error.message,
        field=error.field,
        index=error.index,
        cure=error.cure,
        extra=error.extra,
    )


def public(error: BaseException) -> dict[str, Any]:
    """What a caller may know of an error: all of a refusal, but of a fault of ours only that it is one."""
    if isinstance(error, GapmesError) and error.status != 500:
        return of_error(error)
    code = error.code if isinstance(error, GapmesError) else "internal_error"
    unexpected = "" if isinstance(error, GapmesError) else "an unexpected "
    return problem(500, code, f"the service failed with {unexpected}{type(error).__name__}", cure=_OURS)


def plain(value: Any) -> Any:
    """JSON without surprises: numpy scalars and arrays as numbers, NaN and infinity as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
