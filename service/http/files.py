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
from ..scene_files import unknown
from ..store import SceneStore
from . import problems
from .responses import PLY
from .spilled import SpilledResponse

_RANGE = re.compile(rb"bytes=(\d+-\d*|-\d+)(\s*,\s*(\d+-\d*|-\d+))*")


def etag_of(path: Path) -> str:
    """A strong tag: scenes are written once, so that their time and size tell one file from another."""
    status = path.stat()
    return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def matches(request: Request, etag: str) -> bool:
    """Whether `If-None-Match` (RFC 9110 section 13.1.2) lists the tag, weakly compared."""
    tags = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
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
        "Cache-Control": "private, no-cache",
        "Accept-Ranges": "none",
        "Content-Disposition": f'attachment; filename="{name}"',
    }
    if made is not None:
        return SpilledResponse(made.file, MEDIA_TYPE, {**headers, "X-Gapmes-Notes": json.dumps(made.notes)})
    answer = Response(media_type=MEDIA_TYPE, headers=headers)
    del answer.headers["content-length"]  # not known before it is made
    return answer


class SceneFile(FileResponse):
    """A scene's .ply; the scene is being read until the last byte is sent."""

    def __init__(self, store: SceneStore, scene_id: str, etag: str, size: int) -> None:
        super().__init__(
            store.root / scene_id / "scene.ply",
            media_type=PLY,
            filename=f"{scene_id}.ply",
            headers={"ETag": etag, "Cache-Control": "private, no-cache"},
        )
        self._store, self._scene_id, self._size = store, scene_id, size

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """What is no range is passed over; one that the file does not have is answered by a problem document."""
        headers = [(name, value) for name, value in scope["headers"] if name != b"range" or _RANGE.fullmatch(value)]
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
