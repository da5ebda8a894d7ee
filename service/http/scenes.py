"""The store over HTTP: list the scenes, read one as a document or as a .ply, delete it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Query, Request, Response

from ..errors import InputError
from ..scene_files import is_id
from .files import SceneFile, etag_of, matches, not_modified
from .responses import PLY, json_response
from .runtime import Runtime, runtime_of
from .schemas import SceneDocument, SceneList

router = APIRouter(tags=["scenes"])

Held = Annotated[Runtime, Depends(runtime_of)]

# Ids are matched as paths: a slash in one, encoded or not, is an unknown scene and not another route.


@router.get("/scenes", response_model=SceneList)
def list_scenes(
    runtime: Held,
    limit: Annotated[int, Query(ge=1, le=1000, description="how many at most")] = 100,
    after: Annotated[str | None, Query(max_length=60, description="`next` of the page before")] = None,
) -> Response:
    """Scenes, newest first, with their links; `next` names where the following page begins, null on the last."""
    rows = runtime.store.page(limit + 1, None if after is None else _place(after))
    scenes = [{**row.summary, "links": links(row.id, row.summary["views"])} for row in rows[:limit]]
    more = f"{rows[limit - 1].created_ns}-{rows[limit - 1].id}" if len(rows) > limit else None
    return json_response({"scenes": scenes, "next": more})


@router.head("/scenes/{scene_id:path}.ply", include_in_schema=False)
@router.get(
    "/scenes/{scene_id:path}.ply",
    response_class=Response,
    responses={
        200: {"description": "the file", "content": {PLY: {}}},
        206: {"description": "the part of it that `Range` asks for", "content": {PLY: {}}},
        304: {"description": "`If-None-Match` has its tag"},
    },
)
def scene_ply(request: Request, scene_id: str, runtime: Held) -> Response:
    """The .ply, as every 3DGS viewer reads it; whole, by ranges, or 304 where `If-None-Match` has its tag."""
    with runtime.store.reading(scene_id) as path:
        etag, size = etag_of(path), path.stat().st_size
    if matches(request, etag):
        return not_modified(etag)
    return SceneFile(runtime.store, scene_id, etag, size)


@router.get("/scenes/{scene_id:path}", response_model=SceneDocument)
def scene_document(scene_id: str, runtime: Held) -> Response:
    """The scene document: model, cameras, depths, counts, warnings, timings, links."""
    return json_response(with_links(runtime.store.document(scene_id)))


@router.delete("/scenes/{scene_id:path}", status_code=204)
def delete_scene(scene_id: str, runtime: Held) -> Response:
    """Remove a scene and its files."""
    runtime.store.delete(scene_id)
    return Response(status_code=204)


def with_links(document: Mapping[str, Any], views: Sequence[str] = ()) -> dict[str, Any]:
    """The document with where it, its .ply and its views are; `views` are further renders that were asked for."""
    scene_id = document["id"]
    found = links(scene_id, len(document["view_cameras"]))
    if views:
        found["renders"] = [_render_link(scene_id, spec) for spec in views]
    return {**document, "links": found}


def links(scene_id: str, views: int) -> dict[str, Any]:
    """Where a scene is, and its .ply, and the pictures from its views."""
    return {
        "self": f"/scenes/{scene_id}",
        "ply": f"/scenes/{scene_id}.ply",
        "preview": f"/scenes/{scene_id}/preview",
        "sheet": f"/scenes/{scene_id}/sheet",
        "views": [_render_link(scene_id, str(index)) for index in range(views)],
    }


def _place(text: str) -> tuple[int, str]:
    instant, _, scene_id = text.partition("-")
    if not (instant.isascii() and instant.isdigit() and len(instant) < 20 and int(instant) < 2**63 and is_id(scene_id)):
        raise InputError(f"{text!r} is no place in the list", field="after", cure="take `next` of the page before")
    return int(instant), scene_id


def _render_link(scene_id: str, view: str) -> str:
    return f"/render?{urlencode({'scene': scene_id, 'view': view}, safe=':')}"
