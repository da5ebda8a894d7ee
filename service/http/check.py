"""`POST /check`: what a reconstruction of the same form would take its photographs and cameras for."""

from __future__ import annotations

import base64
import io
from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Depends, Request, Response
from PIL import Image

from ..camera_file import camera_document
from ..depth_range import depth_range
from ..fitting import fit_notices
from ..image_files import check_total
from ..images import Photo, decode_image
from ..model_info import ModelInfo
from ..pose_notices import pose_notices
from ..settings import Settings
from ..view_checks import check_views
from .form import FORM
from .responses import json_response
from .runtime import Runtime, runtime_of
from .schemas import Understood
from .upload import Upload, read_upload

router = APIRouter(tags=["reconstruction"])

THUMBNAIL = 160  # px, longer side


@router.post(
    "/check",
    response_model=Understood,
    openapi_extra={"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": FORM}}}},
)
async def check(request: Request, runtime: Annotated[Runtime, Depends(runtime_of)]) -> Response:
    """Read the form of `POST /reconstruct` and check cameras and photographs as it would; the network is not asked,
    nothing is stored. Answers with the cameras in the service's own terms, the depth range and small pictures."""
    models = runtime.models  # refuses until there is one
    async with runtime.uploads.place():
        upload = await read_upload(request, runtime.settings, models.names)
        info = models.get(upload.work.model).file.info
        document = await anyio.to_thread.run_sync(_understood, upload, runtime.settings, info)
    return json_response(document)


def _understood(upload: Upload, settings: Settings, info: ModelInfo) -> dict[str, Any]:
    work, pairing = upload.work, upload.pairing
    check_total(work.images, max_pixels=settings.max_image_pixels, max_total=settings.max_request_pixels)
    depths = depth_range(work.cameras, work.near, work.far)
    warnings = [*pairing.warnings, *check_views(work.cameras, depths, trust_poses=work.trust_poses)]
    warnings += pose_notices(work.cameras, depths.near)
    images = []
    for index, (image, view) in enumerate(zip(pairing.images, pairing.views, strict=True)):
        photo = decode_image(image.data, index=index, max_pixels=settings.max_image_pixels)
        warnings += fit_notices(photo, view.camera, view.lens, index, info)
        size = {"width": photo.width, "height": photo.height}
        images.append(
            {"name": image.name, **size, "thumbnail": _thumbnail(photo), "camera": camera_document(view.camera)}
        )
    return {
        "images": images,
        "paired_by": pairing.by,
        "selection": upload.selection,
        "near": depths.near,
        "far": depths.far,
        "depth_range_source": depths.source,
        "warnings": warnings,
    }


def _thumbnail(photo: Photo) -> str:
    """A small JPEG of the photograph as stored, in base64."""
    small = Image.fromarray(photo.rgb)
    small.thumbnail((THUMBNAIL, THUMBNAIL), reducing_gap=2.0)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=80)
    return base64.b64encode(buffer.getvalue()).decode()
