"""The store over HTTP: list the scenes, read one as a document or as a .ply, delete it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Response
from fastapi.responses import FileResponse

from . import problems
from .responses import PLY, json_response
from .runtime import Runtime, runtime_of

router = APIRouter(tags=["scenes"], responses={404: problems.DESCRIPTION})

Held = Annotated[Runtime, Depends(runtime_of)]

# Ids are matched as paths: a slash in one, encoded or not, is an unknown scene and not another route.


@router.get("/scenes")
def list_scenes(runtime: Held) -> Response:
    """Every scene, newest first, with its links."""
    return json_response({"scenes": [_summary(document) for document in runtime.store.list()]})


@router.get("/scenes/{scene_id:path}.ply", response_class=FileResponse)
def scene_ply(scene_id: str, runtime: Held) -> Response:
    """The .ply, as every 3DGS viewer reads it."""
    return FileResponse(runtime.store.ply_path(scene_id), media_type=PLY, filename=f"{scene_id}.ply")


@router.get("/scenes/{scene_id:path}")
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
    links = {
        "self": f"/scenes/{scene_id}",
        "ply": f"/scenes/{scene_id}.ply",
        "views": [_render_link(scene_id, str(index)) for index in range(len(document["view_cameras"]))],
    }
    if views:
        links["renders"] = [_render_link(scene_id, spec) for spec in views]
    return {**document, "links": links}


def _summary(document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "id": document["id"],
        "created": document["created"],
        "gaussians": document["gaussians"]["count"],
        "views": len(document["view_cameras"]),
        "links": with_links(document)["links"],
    }


def _render_link(scene_id: str, view: str) -> str:
    return f"/render?{urlencode({'scene': scene_id, 'view': view}, safe=':')}"
