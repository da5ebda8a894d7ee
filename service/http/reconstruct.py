"""`POST /reconstruct`: photographs and cameras in; the scene as a document, a .ply or a zip out."""

from __future__ import annotations

from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Depends, Request, Response

from ..scene_views import SceneViews
from . import problems
from .bundle import zip_bundle
from .form import FORM
from .jobs import accepted_job, wanted_async, why_not
from .responses import JSON, PLY, ZIP, accepted, json_response, server_timing
from .runtime import Runtime, runtime_of
from .scenes import with_links
from .schemas import Job, SceneDocument
from .upload import Upload, read_upload
from .waiting import ended

router = APIRouter(tags=["reconstruction"])


@router.post(
    "/reconstruct",
    status_code=201,
    responses={
        200: {
            "model": SceneDocument,
            "description": "the same photographs, cameras, options and weights are in the store already",
            "content": {PLY: {}, ZIP: {}},
        },
        201: {"model": SceneDocument, "description": "the scene", "content": {PLY: {}, ZIP: {}}},
        202: {"model": Job, "description": "a job, where the request prefers respond-async"},
    },
    openapi_extra={"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": FORM}}}},
)
async def reconstruct(request: Request, runtime: Annotated[Runtime, Depends(runtime_of)]) -> Response:
    """Reconstruct a scene, or find it in the store: 201 or 200, both with Location; 202 and a job with the header
    `Prefer: respond-async`."""
    form = accepted(request.headers.get("accept"))
    model_sha256 = runtime.reconstructor.engine.info.file_sha256
    runtime.desk.table.check_room()  # before the body is read, so that a full queue costs no memory
    async with runtime.uploads.place():  # slow senders take no place at the CPU
        upload = await read_upload(request, runtime.settings)
        views = SceneViews(upload.pairing.cameras)
        for spec in upload.views:  # refuse an unknown view before the work, not after it
            views.resolve(spec, field="views")
        scene_id = await anyio.to_thread.run_sync(lambda: upload.work.scene_id(model_sha256))
    if wanted_async(request.headers.getlist("prefer")):
        job, _ = await anyio.to_thread.run_sync(lambda: runtime.desk.submit(upload.work, scene_id, kept=True))
        return accepted_job(runtime, job)
    new = False
    if not runtime.store.exists(scene_id):
        job, new = await anyio.to_thread.run_sync(lambda: runtime.desk.submit(upload.work, scene_id, kept=False))
        job = await ended(runtime.desk.table, job, runtime.settings.wait_seconds, request.is_disconnected)
        if job.state != "done":
            return problems.of_document(why_not(job))
    return await _answer(request, runtime, scene_id, form, upload, 201 if new else 200)


async def _answer(
    request: Request, runtime: Runtime, scene_id: str, form: str, upload: Upload, status: int
) -> Response:
    """The stored scene with what this request alone says: its file names and how they were paired."""
    pairing = upload.pairing
    document = with_links(runtime.store.document(scene_id), upload.views)
    document |= {
        "images": [image.name for image in pairing.images],
        "paired_by": pairing.by,
        "warnings": [*pairing.warnings, *document["warnings"]],
    }
    headers = {"Location": document["links"]["self"], "Vary": "Accept, Prefer"}
    if status == 201:
        headers["Server-Timing"] = server_timing(document["timings"])
    if form == JSON:
        return json_response(document, status, headers)
    if form == PLY:
        name, body = f"{scene_id}.ply", await anyio.to_thread.run_sync(runtime.store.ply, scene_id)
    else:
        name = f"{scene_id}.zip"
        body = await runtime.pictures.run(lambda: zip_bundle(runtime, document, upload.views), request.is_disconnected)
    headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return Response(body, status_code=status, media_type=form, headers=headers)
