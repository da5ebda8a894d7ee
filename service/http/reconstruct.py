"""`POST /reconstruct`: photographs and cameras in; the scene as a document, a .ply or a zip out."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Depends, Request, Response

from ..budget import DEFAULT_CERTIFY, MAX_CERTIFY
from ..camera_file import camera_document
from ..foretold import DEFAULT_OTHERS
from ..image_files import check_total
from ..images import EncodedPhoto
from ..ply import ply_bytes
from ..revision import ALGORITHM_REVISION
from ..scene_views import SceneViews
from ..store import SceneStore
from ..stride import STRIDES
from ..view_checks import MAX_VIEWS, MIN_VIEWS
from . import problems
from .bundle import zip_bundle
from .responses import JSON, PLY, ZIP, accepted, json_response
from .runtime import Runtime, runtime_of
from .scenes import with_links
from .upload import Upload, read_upload

router = APIRouter(tags=["reconstruction"])

_FORM = {
    "type": "object",
    "required": ["images", "cameras"],
    "properties": {
        "images": {"type": "array", "items": {"type": "string", "format": "binary"}, "minItems": 2, "maxItems": 6},
        "cameras": {"type": "string", "description": "cameras.json or transforms.json, as a field or as a file part"},
        "near": {"type": "number", "exclusiveMinimum": 0, "description": "nearest depth, in the cameras' units"},
        "far": {"type": "number", "exclusiveMinimum": 0, "description": "farthest depth, in the cameras' units"},
        "views": {"type": "string", "description": "views to render, comma separated: 0, 1.5, orbit:30"},
        "trust_poses": {
            "type": "boolean",
            "description": "warn only, where photographs or overlap speak against the poses",
        },
        "max_error": {
            "type": "string",
            "default": "1/255",
            "description": "change of colour up to which Gaussians are left out, proved for the inputs, the views"
            " between them and `views`: a number, a fraction, or off",
        },
        "certify": {
            "type": "integer",
            "minimum": 0,
            "maximum": MAX_CERTIFY,
            "default": DEFAULT_CERTIFY,
            "description": "views between neighbouring inputs for which that is proved",
        },
        "leave_one_out": {
            "type": "integer",
            "enum": [0, *range(MIN_VIEWS, MAX_VIEWS)],
            "default": DEFAULT_OTHERS,
            "description": "of three photographs or more, how many others foretell each; 0: none are foretold",
        },
        "min_opacity": {"type": "number", "minimum": 0, "maximum": 1, "default": 0, "description": "fainter ones go"},
        "stride": {
            "type": "integer",
            "enum": list(STRIDES),
            "default": 1,
            "description": "pixels per Gaussian, each way",
        },
    },
}


@router.post(
    "/reconstruct",
    status_code=201,
    responses={
        200: {"description": "the same photographs, cameras, options and weights are in the store already"},
        201: {"description": "the scene", "content": {JSON: {}, PLY: {}, ZIP: {}}},
        "4XX": problems.DESCRIPTION,
        "5XX": problems.DESCRIPTION,
    },
    openapi_extra={"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": _FORM}}}},
)
async def reconstruct(request: Request, runtime: Annotated[Runtime, Depends(runtime_of)]) -> Response:
    """Reconstruct a scene, or find it in the store: 201 or 200, both with Location."""
    form = accepted(request.headers.get("accept"))
    model_sha256 = runtime.reconstructor.engine.info.file_sha256
    runtime.gate.places.check()  # before the body is read, so that a full queue costs no memory
    async with runtime.uploads.place():  # slow senders take no place at the CPU
        upload = await read_upload(request, runtime.settings)
        views = SceneViews(upload.pairing.cameras)
        for spec in upload.views:  # refuse an unknown view before the work, not after it
            views.resolve(spec, field="views")
        scene_id = await anyio.to_thread.run_sync(lambda: _scene_id(model_sha256, upload))
    async with runtime.gate.admitted(), runtime.gate.alone(scene_id):
        created = not runtime.store.exists(scene_id)
        if created:
            await runtime.gate.run(lambda: _compute(runtime, scene_id, upload))
        return await _answer(runtime, scene_id, form, upload, 201 if created else 200)


def _scene_id(model_sha256: str, upload: Upload) -> str:
    """Everything that the stored scene depends on, and nothing else: file names are the request's own."""
    budget = upload.budget
    bounded = budget.max_error is not None or budget.min_opacity > 0
    return SceneStore.scene_id(
        model_sha256,
        [image.data for image in upload.pairing.images],
        [{**camera_document(camera), "drift": camera.drift} for camera in upload.pairing.cameras],
        {
            "near": upload.near,
            "far": upload.far,
            "trust_poses": upload.trust_poses,
            "max_error": budget.max_error,
            "certify": budget.certify if bounded else None,
            "views": budget.asked if bounded else None,
            "min_opacity": budget.min_opacity,
            "stride": budget.stride,
            "leave_one_out": min(upload.leave_one_out, len(upload.pairing.images) - 1)
            if len(upload.pairing.images) > MIN_VIEWS
            else 0,
            "algorithm_revision": ALGORITHM_REVISION,
        },
    )


def _compute(runtime: Runtime, scene_id: str, upload: Upload) -> None:
    """Decode, reconstruct and store, on a worker thread; the store keeps the whole scene or nothing."""
    pairing = upload.pairing
    limits = runtime.settings
    encoded = [image.data for image in pairing.images]
    check_total(encoded, max_pixels=limits.max_image_pixels, max_total=limits.max_request_pixels)
    photos = [EncodedPhoto(data, limits.max_image_pixels) for data in encoded]
    scene = runtime.reconstructor.reconstruct(
        photos,
        pairing.cameras,
        near=upload.near,
        far=upload.far,
        trust_poses=upload.trust_poses,
        budget=upload.budget,
        leave_one_out=upload.leave_one_out,
    )
    document = {
        "id": scene_id,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        **scene.document,
    }
    runtime.store.put(scene_id, ply_bytes(scene.gaussians), document)


async def _answer(runtime: Runtime, scene_id: str, form: str, upload: Upload, status: int) -> Response:
    """The stored scene with what this request alone says: its file names and how they were paired."""
    views, pairing = upload.views, upload.pairing
    document = with_links(runtime.store.document(scene_id), views)
    document |= {
        "images": [image.name for image in pairing.images],
        "paired_by": pairing.by,
        "warnings": [*pairing.warnings, *document["warnings"]],
    }
    headers = {"Location": document["links"]["self"], "Vary": "Accept"}
    if form == JSON:
        return json_response(document, status, headers)
    if form == PLY:
        body = runtime.store.ply_path(scene_id).read_bytes()
        name = f"{scene_id}.ply"
    else:
        body = await runtime.gate.run(lambda: zip_bundle(runtime, document, views))
        name = f"{scene_id}.zip"
    headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return Response(body, status_code=status, media_type=form, headers=headers)
