"""Entity tags, and a scene's file as an answer: by ranges, never evicted while it is sent."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import FileResponse
from starlette.types import Receive, Scope, Send

from ..errors import SceneNotFound
from ..problem_document import of_error
from ..store import SceneStore
from . import problems
from .responses import PLY


def etag_of(path: Path) -> str:
    """A strong tag: scenes are written once, so that their time and size tell one file from another."""
    status = path.stat()
    return f'"{status.st_mtime_ns:x}-{status.st_size:x}"'


def matches(request: Request, etag: str) -> bool:
    """Whether `If-None-Match` (RFC 9110 section 13.1.2) lists the tag, weakly compared."""
    tags = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
    return "*" in tags or etag in tags


def not_modified(etag: str, headers: Mapping[str, str] | None = None) -> Response:
    """304: the client has it."""
    return Response(status_code=304, headers={"ETag": etag, **(headers or {})})


class SceneFile(FileResponse):
    """A scene's .ply; the scene is being read until the last byte is sent."""

    def __init__(self, store: SceneStore, scene_id: str, etag: str) -> None:
        super().__init__(
            store.root / scene_id / "scene.ply",
            media_type=PLY,
            filename=f"{scene_id}.ply",
            headers={"ETag": etag, "Cache-Control": "private, no-cache"},
        )
        self._store, self._scene_id = store, scene_id

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            with self._store.reading(self._scene_id):
                await super().__call__(scope, receive, send)
        except SceneNotFound as error:  # deleted meanwhile; nothing was sent yet
            await problems.response(of_error(error))(scope, receive, send)
