"""`POST /reconstruct`: photographs and cameras in; a scene document, .ply or zip out, or a job."""

from __future__ import annotations

from contextlib import AsyncExitStack, ExitStack, suppress
from functools import partial
from typing import IO

import anyio.to_thread
from fastapi import APIRouter, Request, Response

from ..errors import FormatError, SceneNotFound
from ..scenes.store import SceneStore
from . import problems
from .bundle import zip_bundle
from .digests import REPR_DIGEST, repr_digest
from .form import FORM
from .jobs import accepted_job, wanted_async, why_not
from .limits import RELEASE
from .observe import JOB
from .responses import JSON, PLY, ZIP, accepted, json_response, server_timing
from .runtime import Runtime, RuntimeDep
from .scenes import with_links
from .schemas import Job, SceneDocument
from .spilled import SpilledResponse, spilled
from .upload import RequestSummary, read_upload
from .waiting import ended

router = APIRouter(tags=["reconstruction"])


@router.post(
    "/reconstruct",
    status_code=201,
    responses={
        200: {
            "model": SceneDocument,
            "description": "the same photographs, cameras, options and model are in the store already",
            "content": {PLY: {}, ZIP: {}},
        },
        201: {"model": SceneDocument, "description": "the scene", "content": {PLY: {}, ZIP: {}}},
        202: {"model": Job, "description": "a job, where the request prefers respond-async"},
    },
    openapi_extra={"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": FORM}}}},
)
async def reconstruct(request: Request, runtime: RuntimeDep) -> Response:
    """Reconstruct a scene, or find it in the store: 201 for a new scene, else 200, both with Location; 202 and a job
    with the header `Prefer: respond-async`."""
    form = accepted(", ".join(request.headers.getlist("accept")))
    models = runtime.models  # raises `ModelNotReady` until the default model is loaded
    await anyio.to_thread.run_sync(runtime.jobs.table.check_room)  # before the body: a full queue costs no memory
    kept = wanted_async(request.headers.getlist("prefer"))
    if not kept:
        runtime.scenes.check()
    async with AsyncExitStack() as held:
        async with runtime.uploads.slot():  # slow senders do not occupy a slot of `scenes`
            upload = await read_upload(request, runtime.settings, models.names)
            await anyio.to_thread.run_sync(upload.check, runtime.settings)
            work, summary = upload.work, RequestSummary.of(upload)
            del upload
            scene_id = await anyio.to_thread.run_sync(work.scene_id, models.get(work.model).identity)
            job, new = None, False
            if not kept:
                await held.enter_async_context(runtime.scenes.slot())
            scene = held.enter_context(ExitStack())  # keeps the scene from eviction until the answer is made
            if kept or not await anyio.to_thread.run_sync(_there, runtime.store, scene_id, scene):
                submit = partial(runtime.jobs.submit, work, scene_id, kept=kept)
                job, new = await anyio.to_thread.run_sync(submit)
                request.scope["state"][JOB] = job.id
                del submit
            del work  # frees the photographs, which are on disk now
            request.scope[RELEASE]()
        if job is not None and kept:
            return await anyio.to_thread.run_sync(accepted_job, runtime, job, summary.document())
        if job is not None:
            job = await ended(runtime.jobs, job, runtime.settings.wait_seconds, request.is_disconnected)
            if job.state != "done":
                return problems.of_document(why_not(job))
            await anyio.to_thread.run_sync(lambda: scene.enter_context(runtime.store.keeping(scene_id)))
        return await _answer(request, runtime, scene_id, form, summary, 201 if new else 200)


def _there(store: SceneStore, scene_id: str, held: ExitStack) -> bool:
    """Whether the scene is stored undamaged; if so, `held` keeps it from eviction. To be called on a worker thread."""
    with suppress(SceneNotFound, FormatError), ExitStack() as kept:
        kept.enter_context(store.keeping(scene_id))
        if store.exists(scene_id):
            held.enter_context(kept.pop_all())
            return True
    return False


def _ply(runtime: Runtime, scene_id: str) -> tuple[IO[bytes], str]:
    """The scene's .ply to be sent, and the value of `Repr-Digest`. To be called on a worker thread."""
    data = runtime.store.ply(scene_id)
    return spilled(data, runtime.store.root), repr_digest(data)


async def _answer(
    request: Request, runtime: Runtime, scene_id: str, form: str, summary: RequestSummary, status: int
) -> Response:
    """The stored scene, with members about this request: file names, pairing, selection and warnings."""
    document = with_links(await anyio.to_thread.run_sync(runtime.store.document, scene_id), summary.views)
    document |= summary.document() | {"warnings": [*summary.warnings, *document["warnings"]]}
    headers = {"Location": document["links"]["self"], "Vary": "Accept, Prefer"}
    if status == 201:
        headers["Server-Timing"] = server_timing(document["timings"])
    if form == JSON:
        return json_response(document, status, headers)
    if form == PLY:
        name = f"{scene_id}.ply"
        body, headers[REPR_DIGEST] = await anyio.to_thread.run_sync(_ply, runtime, scene_id)
    else:
        name = f"{scene_id}.zip"
        body = await zip_bundle(runtime, document, summary.views, request.is_disconnected)
    headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return SpilledResponse(body, form, headers, status)
