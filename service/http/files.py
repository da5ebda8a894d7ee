"""Entity tags, and responses with a scene's files: the .ply with ranges, other formats converted for each request."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import IO

import anyio.to_thread
from fastapi import Request, Response
from fastapi.responses import FileResponse
from starlette.types import Message, Receive, Scope, Send

from ..errors import SceneNotFound
from ..formats.registry import MEDIA_TYPE
from ..problem_document import of_error, problem
from ..revision import DRAWING_REVISION
from ..scenes.scene_files import unknown
from ..scenes.store import SceneStore
from . import problems
from .digests import REPR_DIGEST
from .responses import PLY, head_alone
from .spilled import SpilledResponse

ASKED_AGAIN = "private, no-cache"  # may be stored, but must be revalidated by its tag
_RANGE = re.compile(rb"(?i:bytes)=([\s,]*(\d+-\d*|-\d+)(\s*,[\s,]*(\d+-\d*|-\d+))*[\s,]*)")  # items may be empty


def etag_of(path: Path) -> str:
    """A strong entity tag of a scene's file, which is never modified: its time and size."""
    status = path.stat()
    return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def matches(request: Request, etag: str) -> bool:
    """Whether `If-None-Match` (RFC 9110 section 13.1.2) lists the tag, by weak comparison."""
    listed = ",".join(request.headers.getlist("if-none-match"))
    tags = [tag.strip().removeprefix("W/") for tag in listed.split(",")]
    return "*" in tags or etag.removeprefix("W/") in tags


def not_modified(headers: Mapping[str, str]) -> Response:
    """A response 304 with these headers, the tag among them."""
    return Response(status_code=304, headers=headers)


def etag_of_converted(etag: str, extension: str) -> str:
    """Entity tag of a file that is converted from the one with `etag`; it changes with the release."""
    parts = [etag, extension, version("gapmes"), DRAWING_REVISION]
    return f'"{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]}"'


@dataclass(frozen=True)
class Made:
    """A converted file, and notes about what its format cannot hold."""

    file: IO[bytes]
    notes: tuple[str, ...]
    digest: str  # the value of `Repr-Digest`


def converted_file(name: str, etag: str, made: Made | None) -> Response:
    """The response with a converted file; None for HEAD, for which none is made."""
    headers = {
        "ETag": etag,
        "Cache-Control": ASKED_AGAIN,
        "Accept-Ranges": "none",
        "Content-Disposition": f'attachment; filename="{name}"',
    }
    if made is not None:
        headers |= {REPR_DIGEST: made.digest, "X-Gapmes-Notes": json.dumps(made.notes)}
        return SpilledResponse(made.file, MEDIA_TYPE, headers)
    return head_alone(MEDIA_TYPE, headers)


class SceneFile(FileResponse):
    """A scene's .ply, which is kept from eviction until the last byte is sent."""

    def __init__(self, store: SceneStore, scene_id: str, etag: str, size: int, digest: str) -> None:
        super().__init__(
            store.root / scene_id / "scene.ply",
            media_type=PLY,
            filename=f"{scene_id}.ply",
            headers={"ETag": etag, "Cache-Control": ASKED_AGAIN, REPR_DIGEST: digest},
        )
        self._store, self._scene_id, self._size = store, scene_id, size

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """A malformed `Range` is ignored, as is any with HEAD (RFC 9110 section 14.2); of several ranges, those beyond
        the end of the file are left out. If all are beyond it, the answer is a problem document with status 416."""
        headers = [(name, value) for name, value in scope["headers"] if name != b"range"]
        asked = next((value for name, value in scope["headers"] if name == b"range"), b"")
        if scope["method"] == "GET" and (ranges := _there(asked, self._size)):
            headers.append((b"range", ranges))
        beyond = False

        async def watched(message: Message) -> None:
            nonlocal beyond
            beyond = beyond or message.get("status") in (400, 416)
            if not beyond:
                await send(message)

        try:
            with ExitStack() as held:
                await anyio.to_thread.run_sync(lambda: held.enter_context(self._store.reading(self._scene_id)))
                await super().__call__({**scope, "headers": headers}, receive, watched)
        except (SceneNotFound, RuntimeError) as error:  # deleted before anything was sent
            if isinstance(error, RuntimeError) and await anyio.to_thread.run_sync(self._store.exists, self._scene_id):
                raise
            await problems.response(of_error(unknown(self._scene_id)))(scope, receive, send)
        if beyond:
            document = problem(416, "range_not_satisfiable", f"the file has {self._size} bytes", field="Range")
            whole = {"Content-Range": f"bytes */{self._size}"}
            await problems.response(document, whole)(scope, receive, send)


def _there(asked: bytes, size: int) -> bytes:
    """A `Range` header (RFC 9110 section 14.1.2) reduced to the ranges that a file of `size` bytes has; unchanged if it
    has none of them, empty if the header is malformed."""
    found = _RANGE.fullmatch(asked)
    if found is None:
        return b""
    kept = []
    for part in filter(None, (part.strip() for part in found[1].split(b","))):
        first, last = (_number(digits) for digits in part.split(b"-"))
        if first is None:  # a suffix of so many bytes
            kept += [b"-%d" % last] if last else []
            continue
        if last is not None and last < first:
            return b""
        if first < size:
            kept.append(b"%d-%d" % (first, size - 1 if last is None else last))
    return b"bytes=" + b",".join(kept) if kept else asked


def _number(digits: bytes) -> int | None:
    """None without digits; 10^18 for numbers of 19 digits or more."""
    return (int(digits) if len(digits) < 19 else 10**18) if digits else None
