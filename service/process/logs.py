"""The log on stderr: a line per event, as text or JSON, with the id of the request that it belongs to."""

from __future__ import annotations

import contextvars
import json
import logging
import sys
import time
import warnings
from typing import Any, Literal

REQUEST_ID: contextvars.ContextVar[str | None] = contextvars.ContextVar("request_id", default=None)
OVER_LIMIT = "the limit"  # prefix of messages about a limit that is reached
NO_FILES = "socket.accept() out of system resource"  # prefix of the event loop's message, once per attempt
SELDOM_S = 10.0  # between two lines with the same of these prefixes, or `_ORIGIN`
_ORIGIN = "origin"  # attribute of a record: what is told seldom, whatever its words
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "color_message", "request_id", _ORIGIN}


def configure(form: Literal["text", "json"], *, quiet: bool = False) -> None:
    """Send the log of this process to stderr. The server's own access log is replaced by that of `http/observe.py`.

    `quiet`: warnings and errors only.
    """
    handler = _Stderr()
    handler.setFormatter(_Json() if form == "json" else _Text())
    handler.addFilter(_with_request)
    handler.addFilter(_RateLimited())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING if quiet else logging.INFO)
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = name != "uvicorn.access"
    warnings.showwarning = _of_a_library


def _of_a_library(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any, **__: Any
) -> None:
    """A warning of Python's, such as Pillow's about a photograph with damaged EXIF: an event like others. One
    photograph can cause tens of thousands from one line of code."""
    text, origin = " ".join(str(message).split()), {_ORIGIN: f"{filename}:{lineno}"}
    logging.getLogger("gapmes").info("%s: %s", category.__name__, text, extra=origin)


class _Stderr(logging.StreamHandler):
    """Writes to the current `sys.stderr`, so that lines appear above progress bars."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)


def _with_request(record: logging.LogRecord) -> bool:
    if not hasattr(record, "request_id"):
        record.request_id = REQUEST_ID.get()
    return True


class _RateLimited(logging.Filter):
    """Rate limit for messages that clients can cause many times a second; each is a single line."""

    def __init__(self) -> None:
        super().__init__()
        self._said: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        message = record.getMessage()
        begun = next((begin for begin in (OVER_LIMIT, NO_FILES) if message.startswith(begin)), None)
        begin = getattr(record, _ORIGIN, begun)
        if begin is None:
            return True
        if abs(record.created - self._said.get(begin, -SELDOM_S)) < SELDOM_S:  # the clock may be set back
            return False
        self._said[begin] = record.created
        if begin == NO_FILES:
            record.msg, record.args, record.exc_info = "no further connection: raise the limit of open files", (), None
        return True


class _Text(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        more = "".join(f" {name}={value}" for name, value in _fields(record).items())
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line = f"{stamp}Z {record.levelname.lower():7} {record.getMessage()}{more}"
        return line if record.exc_info is None else f"{line}\n{self.formatException(record.exc_info)}"


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        entry: dict[str, Any] = {
            "time": round(record.created, 6),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **_fields(record),
        }
        if record.exc_info is not None:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, default=str)


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    """Extra fields of the record, and its request id."""
    fields = {name: value for name, value in vars(record).items() if name not in _STANDARD}
    if record.request_id is not None:  # type: ignore[attr-defined]
        fields["request_id"] = record.request_id  # type: ignore[attr-defined]
    return fields
