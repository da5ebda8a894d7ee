"""`POST /reconstruct`: photographs and cameras in; the scene as a document, a .ply or a zip out."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from ..camera_file import camera_document
from ..images import decode_image
from ..ply import ply_bytes
from ..scene_views import SceneViews
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
        "trust_poses": {"type": "boolean", "description": "only warn where the photographs contradict the poses"},
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
    settings = runtime.settings
    upload = await read_upload(
        request, max_camera_bytes=settings.max_camera_bytes, max_upload_bytes=settings.max_upload_bytes
    )
    views = SceneViews(upload.pairing.cameras)
    for spec in upload.views:  # refuse an unknown view before the work, not after it
        views.resolve(spec, field="views")
    store = runtime.store
    scene_id = store.scene_id(
        model_sha256,
        [image.data for image in upload.pairing.images],
        [camera_document(camera) for camera in upload.pairing.cameras],
        {"near": upload.near, "far": upload.far, "trust_poses": upload.trust_poses},
    )
    async with runtime.gate.admitted(), runtime.gate.alone(scene_id):
        created = not store.exists(scene_id)
        if created:
            await runtime.gate.run(lambda: _compute(runtime, scene_id, upload))
        return await _answer(runtime, scene_id, form, upload.views, 201 if created else 200)


def _compute(runtime: Runtime, scene_id: str, upload: Upload) -> None:
    """Decode, reconstruct and store, on a worker thread; the store keeps the whole scene or nothing."""
    pairing = upload.pairing
    limit = runtime.settings.max_image_pixels
    photos = [decode_image(image.data, index=index, max_pixels=limit) for index, image in enumerate(pairing.images)]
    scene = runtime.reconstructor.reconstruct(
        photos, pairing.cameras, near=upload.near, far=upload.far, trust_poses=upload.trust_poses
    )
    document = {
        "id": scene_id,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        **scene.document,
        "images": [image.name for image in pairing.images],
        "paired_by": pairing.by,
        "warnings": [*pairing.warnings, *scene.document["warnings"]],
    }
    runtime.store.put(scene_id, ply_bytes(scene.gaussians), document)


async def _answer(runtime: Runtime, scene_id: str, form: str, views: tuple[str, ...], status: int) -> Response:
    document = with_links(runtime.store.document(scene_id), views)
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
