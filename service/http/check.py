"""`POST /check`: how the photographs and cameras of a form would be interpreted by a reconstruction."""

from __future__ import annotations

import base64
import io
from functools import partial
from typing import Any

from fastapi import APIRouter, Request, Response
from PIL import Image

from ..cameras.camera_file import camera_document
from ..cameras.view_checks import DEPTH_PLANES, range_notices
from ..network.model_info import ModelInfo
from ..photographs.fitting import fit_notices
from ..photographs.images import Photo, decode_image, match_photo
from ..photographs.rolled import quarter_turns
from ..photographs.undistort import match_lens
from ..photographs.whole import view_shapes
from ..settings import Settings
from .form import FORM
from .responses import json_response
from .runtime import RuntimeDep
from .schemas import Understood
from .upload import Upload, read_upload

router = APIRouter(tags=["reconstruction"])

THUMBNAIL = 160  # px, longer side


@router.post(
    "/check",
    response_model=Understood,
    openapi_extra={"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": FORM}}}},
)
async def check(request: Request, runtime: RuntimeDep) -> Response:
    """Read the form of `POST /reconstruct` and check its cameras and photographs in the same way, without running the
    network or storing anything. Answers with the cameras in the service's conventions, the depth range and
    thumbnails."""
    models = runtime.models  # refuses until there is one
    async with runtime.uploads.slot():
        upload = await read_upload(request, runtime.settings, models.names)
    info = models.get(upload.work.model).file.info
    understood = partial(_understood, upload, runtime.settings, info)
    document = await runtime.looks.run(understood, request.is_disconnected)
    return json_response(document)


def _understood(upload: Upload, settings: Settings, info: ModelInfo) -> dict[str, Any]:
    work, pairing = upload.work, upload.pairing
    numbers = upload.selection["views"]
    depths, found = upload.check(settings)
    warnings = [*pairing.warnings, *range_notices(depths, info.depth_planes or DEPTH_PLANES), *found]
    images = []
    turns = quarter_turns(work.cameras, square=info.height == info.width)
    shapes = view_shapes(work.cameras, turns, info.shape)
    for number, image, view, shape in zip(numbers, pairing.images, pairing.views, shapes, strict=True):
        photo = decode_image(image.data, index=number, max_pixels=settings.max_image_pixels)
        warnings += fit_notices(photo, view.camera, view.lens, number, shape, work.detail)
        if view.lens is None:  # turned upright if both EXIF and the camera say so
            photo, _ = match_photo(photo, view.camera, index=number)
        else:
            photo = match_lens(photo, view.lens, index=number)
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
        "depth_range_source": "cameras" if depths.source == "estimated" else depths.source,
        "warnings": warnings,
    }


def _thumbnail(photo: Photo) -> str:
    """A small JPEG of the photograph, in base64."""
    small = Image.fromarray(photo.rgb)
    small.thumbnail((THUMBNAIL, THUMBNAIL), reducing_gap=2.0)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=80)
    return base64.b64encode(buffer.getvalue()).decode()
