"""Entity tags, and a scene's files as answers: the .ply by ranges and never evicted while it is sent, others made."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import IO

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
from .responses import PLY, head_alone
from .spilled import SpilledResponse

ASKED_AGAIN = "private, no-cache"  # kept by a client, which asks with the tag whether it is still right
_RANGE = re.compile(rb"(?i:bytes)=([\s,]*(\d+-\d*|-\d+)(\s*,[\s,]*(\d+-\d*|-\d+))*[\s,]*)")  # a list may have gaps


def etag_of(path: Path) -> str:
    """A strong tag: scenes are written once, so that their time and size tell one file from another."""
    status = path.stat()
    return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def matches(request: Request, etag: str) -> bool:
    """Whether `If-None-Match` (RFC 9110 section 13.1.2) lists the tag, weakly compared."""
    listed = ",".join(request.headers.getlist("if-none-match"))
    tags = [tag.strip().removeprefix("W/") for tag in listed.split(",")]
    return "*" in tags or etag.removeprefix("W/") in tags


def not_modified(etag: str, headers: Mapping[str, str] | None = None) -> Response:
    """304: the client has it."""
    return Response(status_code=304, headers={"ETag": etag, **(headers or {})})


def etag_of_converted(etag: str, extension: str) -> str:
    """Of a file that is made from the one with `etag`: another release may write it otherwise."""
    parts = [etag, extension, version("gapmes"), DRAWING_REVISION]
    return f'"{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]}"'


@dataclass(frozen=True)
class Made:
    """A file that was made for one answer, and what its format cannot hold."""

    file: IO[bytes]
    notes: tuple[str, ...]


def converted_file(name: str, etag: str, made: Made | None) -> Response:
    """The answer with what was made for it; None is for HEAD, for which nothing is made."""
    headers = {
        "ETag": etag,
        "Cache-Control": ASKED_AGAIN,
        "Accept-Ranges": "none",
        "Content-Disposition": f'attachment; filename="{name}"',
    }
    if made is not None:
        return SpilledResponse(made.file, MEDIA_TYPE, {**headers, "X-Gapmes-Notes": json.dumps(made.notes)})
    return head_alone(MEDIA_TYPE, headers)


class SceneFile(FileResponse):
    """A scene's .ply; the scene is being read until the last byte is sent."""

    def __init__(self, store: SceneStore, scene_id: str, etag: str, size: int) -> None:
        super().__init__(
            store.root / scene_id / "scene.ply",
            media_type=PLY,
            filename=f"{scene_id}.ply",
            headers={"ETag": etag, "Cache-Control": ASKED_AGAIN},
        )
        self._store, self._scene_id, self._size = store, scene_id, size

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """What is no range is passed over, and of several ranges those that the file does not have; where it has none,
        the answer is a problem document."""
        headers = [(name, value) for name, value in scope["headers"] if name != b"range"]
        asked = next((value for name, value in scope["headers"] if name == b"range"), b"")
        if ranges := _there(asked, self._size):
            headers.append((b"range", ranges))
        beyond = False

        async def watched(message: Message) -> None:
            nonlocal beyond
            beyond = beyond or message.get("status") in (400, 416)
            if not beyond:
                await send(message)

        try:
            with self._store.reading(self._scene_id):
                await super().__call__({**scope, "headers": headers}, receive, watched)
        except (SceneNotFound, RuntimeError) as error:  # deleted meanwhile; nothing was sent yet
            if isinstance(error, RuntimeError) and self._store.exists(self._scene_id):
                raise
            await problems.response(of_error(unknown(self._scene_id)))(scope, receive, send)
        if beyond:
            document = problem(416, "range_not_satisfiable", f"the file has {self._size} bytes", field="Range")
            whole = {"Content-Range": f"bytes */{self._size}"}
            await problems.response(document, whole)(scope, receive, send)


def _there(asked: bytes, size: int) -> bytes:
    """What a `Range` header (RFC 9110 section 14.1.2) asks for that a file of `size` bytes has; all of it where it has
    nothing of it, and nothing where it is no range at all."""
    found = _RANGE.fullmatch(asked)
    if found is None:
        return b""
    kept = []
    for part in filter(None, (part.strip() for part in found[1].split(b","))):
        first, last = (_number(digits) for digits in part.split(b"-"))
        if first is None:  # the last so many bytes
            kept += [b"-%d" % last] if last else []
            continue
        if last is not None and last < first:
            return b""
        if first < size:
            kept.append(b"%d-%d" % (first, size - 1 if last is None else last))
    return b"bytes=" + b",".join(kept) if kept else asked


def _number(digits: bytes) -> int | None:
    """None where there are none; as large as any file where there are too many to count."""
    return (int(digits) if len(digits) < 19 else 10**18) if digits else None
