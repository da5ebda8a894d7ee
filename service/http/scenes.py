"""Routes of the store: list scenes, read one as a document or as a file of any format, delete it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Annotated, Any
from urllib.parse import urlencode

import anyio.to_thread
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BeforeValidator, Field
from starlette.convertors import Convertor, register_url_convertor

from ..cameras.view_checks import MAX_VIEWS
from ..errors import FormatUnknown, InputError
from ..formats.registry import FORMATS, MEDIA_TYPE, NAMES
from ..scenes.scene_files import is_id
from .digests import repr_digest, repr_digest_of
from .files import ASKED_AGAIN, Made, SceneFile, converted_file, etag_of, etag_of_converted, matches, not_modified
from .parameters import Parameters, whole
from .responses import json_response
from .runtime import Runtime, RuntimeDep
from .schemas import SceneDocument, SceneList
from .spilled import spilled

router = APIRouter(tags=["scenes"])

_KEPT = "; ".join(f".{extension} {entry.keeps}" for extension, entry in FORMATS.items())

# Ids are matched as paths, so that one with a slash, encoded or not, is an unknown scene and not another route.


class _BeforeDot(Convertor[str]):
    """A path up to its first dot: a pattern that tries every dot takes time with the square of their number."""

    regex = "[^.]*"

    def convert(self, value: str) -> str:
        return value

    def to_string(self, value: str) -> str:
        return value


register_url_convertor("before_dot", _BeforeDot())


class PageQuery(Parameters):
    """Pagination."""

    limit: int = Field(100, ge=1, le=1000, description="how many at most")
    after: str | None = Field(None, max_length=60, description="`next` of the page before")


@router.head("/scenes", include_in_schema=False)
@router.get("/scenes", response_model=SceneList)
def list_scenes(runtime: RuntimeDep, query: Annotated[PageQuery, Query()]) -> Response:
    """Scenes with their links, newest first; `next` is the `after` of the following page, null on the last."""
    limit, after = query.limit, query.after
    rows = runtime.store.page(limit + 1, None if after is None else _place(after))
    scenes = [{**row.summary, "links": links(row.id, row.summary["views"])} for row in rows[:limit]]
    more = f"{rows[limit - 1].created_ns}-{rows[limit - 1].id}" if len(rows) > limit else None
    return json_response({"scenes": scenes, "next": more})


@router.head("/scenes/{scene_id:before_dot}.{extension}", include_in_schema=False)
@router.get(
    "/scenes/{scene_id:before_dot}.{extension}",
    response_class=Response,
    responses={
        200: {"description": f"the file; what each format keeps: {_KEPT}", "content": {MEDIA_TYPE: {}}},
        206: {"description": "the part of the .ply that `Range` asks for", "content": {MEDIA_TYPE: {}}},
        304: {"description": "`If-None-Match` has its tag"},
    },
)
async def scene_file(
    request: Request,
    scene_id: str,
    extension: Annotated[str, Path(json_schema_extra={"enum": list(FORMATS)})],
    runtime: RuntimeDep,
) -> Response:
    """The Gaussians as a file of the format of the extension, or 304 if `If-None-Match` has its tag.

    The .ply supports ranges. Other formats are converted from it; `X-Gapmes-Notes` lists what they cannot hold.
    """
    with ExitStack() as held:  # until the answer is made
        etag, size = await anyio.to_thread.run_sync(_stored, runtime, scene_id, held)
        if extension not in FORMATS:
            raise FormatUnknown(
                f"{extension[:50]!r} is no format of a scene", field="extension", cure=f"one of {NAMES}"
            )
        if extension != "ply":
            etag = etag_of_converted(etag, extension)
        if matches(request, etag):
            return not_modified({"ETag": etag, "Cache-Control": ASKED_AGAIN})
        if extension == "ply":
            digest = await anyio.to_thread.run_sync(_digest, runtime, scene_id, etag)
            return SceneFile(runtime.store, scene_id, etag, size, digest)

        def convert() -> Made:
            encoded = FORMATS[extension].write(runtime.store.gaussians(scene_id))
            return Made(spilled(encoded.data, runtime.store.root), encoded.notes, repr_digest(encoded.data))

        made = None if request.method == "HEAD" else await runtime.files.run(convert, request.is_disconnected)
        return converted_file(f"{scene_id}.{extension}", etag, made)


@router.head("/scenes/{scene_id}/inputs/{index}", include_in_schema=False)
@router.get(
    "/scenes/{scene_id}/inputs/{index}",
    response_class=Response,
    responses={200: {"description": "a photograph as the scene has it", "content": {"image/png": {}}}},
)
def scene_input(
    scene_id: str, index: Annotated[int, Path(ge=0, le=MAX_VIEWS - 1), BeforeValidator(whole)], runtime: RuntimeDep
) -> Response:
    """A photograph as the scene has it: resized, with its mask as transparency."""
    headers = {"Cache-Control": "private, max-age=3600"}
    return Response(runtime.store.input(scene_id, index), media_type="image/png", headers=headers)


@router.head("/scenes/{scene_id:path}", include_in_schema=False)
@router.get("/scenes/{scene_id:path}", response_model=SceneDocument)
def scene_document(scene_id: str, runtime: RuntimeDep) -> Response:
    """The scene document: model, cameras, depths, counts, warnings, timings, links."""
    return json_response(with_links(runtime.store.document(scene_id)))


@router.delete("/scenes/{scene_id:path}", status_code=204)
def delete_scene(scene_id: str, runtime: RuntimeDep) -> Response:
    """Remove a scene and its files."""
    runtime.store.delete(scene_id)
    return Response(status_code=204)


def _stored(runtime: Runtime, scene_id: str, held: ExitStack) -> tuple[str, int]:
    """Tag and size in bytes of the .ply; `held` keeps it from eviction. To be called on a worker thread."""
    held.enter_context(runtime.store.keeping(scene_id))
    with runtime.store.reading(scene_id) as path:
        return etag_of(path), path.stat().st_size


def _digest(runtime: Runtime, scene_id: str, etag: str) -> str:
    """The value of `Repr-Digest` for the .ply. To be called on a worker thread."""
    with runtime.store.reading(scene_id) as path:
        return repr_digest_of(path, etag)


def with_links(document: Mapping[str, Any], views: Sequence[str] = ()) -> dict[str, Any]:
    """The document with `links`, including those to renders of the requested `views`."""
    scene_id = document["id"]
    found = links(scene_id, len(document["view_cameras"]))
    if document.get("inputs"):
        found["inputs"] = [f"/scenes/{scene_id}/inputs/{index}" for index in range(document["inputs"])]
    if views:
        found["renders"] = [_render_link(scene_id, spec) for spec in views]
    return {**document, "links": found}


def links(scene_id: str, views: int) -> dict[str, Any]:
    """Paths of a scene's document, files, previews and pictures of its views."""
    return {
        "self": f"/scenes/{scene_id}",
        "ply": f"/scenes/{scene_id}.ply",
        "files": {extension: f"/scenes/{scene_id}.{extension}" for extension in FORMATS},
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
