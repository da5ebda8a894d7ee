"""`POST /scenes`: store an existing file of Gaussians as a scene."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Annotated, Any, Literal

import anyio.to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import Field, ValidationError
from starlette.datastructures import FormData, UploadFile

from ..cameras.camera_fields import CameraFile
from ..cameras.view_checks import Notice
from ..errors import FormatError, InputError, SceneNotFound, UnsupportedMediaType, UploadTooLarge
from ..formats.dialect import Dialect
from ..formats.registry import MEDIA_TYPE, NAMES
from ..scenes.loaded_scene import LoadedFile, load
from ..scenes.store import SceneStore
from ..settings import Settings
from .form import CAMERAS
from .inputs import camera_table
from .parameters import Parameters
from .posted import FORM, MAX_PARTS, in_time, media_type, no_file, posted_form, refuse_compressed, single, size_of, text
from .problems import FORM_PLACE
from .responses import json_response, server_timing
from .runtime import RuntimeDep
from .scenes import with_links
from .schemas import FormatName, SceneDocument

router = APIRouter(tags=["scenes"])

MAX_LOADED_VIEWS = 100  # cameras of a loaded scene: lists of scenes link a picture for each
EXAMPLE = "curl -F file=@scene.splat, or curl --data-binary @scene.ply -H 'Content-Type: application/octet-stream'"


class LoadFields(Parameters):
    """Options for reading a file: query parameters with a raw body, or fields of a form."""

    format: FormatName | None = Field(None, description="of the file; without it its own bytes tell, then its name")
    opacity: Literal["auto", "logit", "linear"] = Field("auto", description="what a .ply holds: logits, or opacities")
    scales: Literal["auto", "log", "linear"] = Field("auto", description="what a .ply holds: logarithms, or sizes")
    rotation: Literal["auto", "wxyz", "xyzw"] = Field("auto", description="order of a .ply's quaternions; auto: wxyz")
    axes: Literal["rub", "rdf"] = Field("rub", description="of a .spz: right-up-back, or right-down-front")
    drop_invalid: bool = Field(False, description="leave out and count Gaussians that cannot be read")
    near: float | None = Field(None, gt=0, allow_inf_nan=False, description="nearest depth, in the file's units")
    far: float | None = Field(None, gt=0, allow_inf_nan=False, description="farthest depth, in the file's units")


def _form_schema() -> dict[str, Any]:
    """JSON schema of the form."""
    fields = LoadFields.model_json_schema()["properties"]
    file = {"type": "string", "format": "binary", "description": f"one of {NAMES}"}
    cameras = {"type": "string", "description": "a camera file, as a field or a file part", "examples": [CAMERAS]}
    return {"type": "object", "required": ["file"], "properties": {"file": file, "cameras": cameras, **fields}}


@router.post(
    "/scenes",
    status_code=201,
    responses={
        200: {"model": SceneDocument, "description": "the same file, read in the same way, is in the store already"},
        201: {"model": SceneDocument, "description": "the scene"},
    },
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                FORM: {"schema": _form_schema()},
                MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}},
            },
        }
    },
)
async def load_scene(request: Request, query: Annotated[LoadFields, Query()], runtime: RuntimeDep) -> Response:
    """Load a .ply, .compressed.ply, .splat or .spz, posted as a raw body or as part `file` of a form, which may also
    have `cameras`; without cameras a default one is used. 201 for a new scene, else 200, both with Location."""
    async with runtime.uploads.slot():
        settings = runtime.settings
        kind = media_type(request)
        if kind == FORM:
            too_many = InputError(f"more than {MAX_PARTS} files, need one", field="file", cure=EXAMPLE)
            async with posted_form(request, settings, EXAMPLE, too_many) as form:
                file = await _of_form(form, settings)
        elif kind == MEDIA_TYPE:
            refuse_compressed(request)
            with in_time(settings):
                data = await request.body()
            file = await anyio.to_thread.run_sync(lambda: _file(data, None, query, None, settings))
        else:
            raise UnsupportedMediaType(
                f"the body is {kind[:100] or 'of no declared type'}, need {FORM} or {MEDIA_TYPE}",
                field="body",
                cure=EXAMPLE,
            )
    scene_id = await anyio.to_thread.run_sync(file.scene_id)
    found = await anyio.to_thread.run_sync(_stored, runtime.store, scene_id)
    loaded = partial(_loaded, file, scene_id, runtime.store, settings.max_gaussians)
    stored, new = (found, False) if found else await runtime.files.run(loaded, request.is_disconnected)
    document = with_links(stored)
    headers = {"Location": document["links"]["self"]}
    if new:
        headers["Server-Timing"] = server_timing(document["timings"])
    return json_response(document, 201 if new else 200, headers)


def _stored(store: SceneStore, scene_id: str) -> dict[str, Any] | None:
    """The document of a stored, undamaged scene, else None; to be called on a worker thread."""
    with suppress(SceneNotFound, FormatError):
        return store.document(scene_id) if store.listed(scene_id) else None
    return None


def _loaded(file: LoadedFile, scene_id: str, store: SceneStore, most: int) -> tuple[dict[str, Any], bool]:
    """The document of the scene, and whether it is new: not if another request for the same file has stored it."""
    stored = _stored(store, scene_id)
    return (stored, False) if stored is not None else load(file, scene_id, store, most)


async def _of_form(form: FormData, settings: Settings) -> LoadedFile:
    part = single(form, "file")
    if not isinstance(part, UploadFile):
        raise no_file(part, "file", EXAMPLE)
    cameras = single(form, "cameras")
    size = 0 if cameras is None else size_of(cameras)
    if size > settings.max_camera_bytes:
        raise UploadTooLarge(
            f"{size} bytes, the limit is {settings.max_camera_bytes}", field="cameras", cure="send fewer cameras"
        )
    document = await cameras.read() if isinstance(cameras, UploadFile) else cameras or None  # as other empty fields
    fields = _checked({name: text(form, name) for name in form if name not in ("file", "cameras")})
    data, name = await part.read(), part.filename
    return await anyio.to_thread.run_sync(lambda: _file(data, name, fields, document, settings))


def _checked(texts: Mapping[str, str]) -> LoadFields:
    """Validate fields; empty ones count as missing. Raises `RequestValidationError`, which names the field."""
    try:
        return LoadFields.model_validate({name: value for name, value in texts.items() if value})
    except ValidationError as error:
        raise RequestValidationError(
            [{**item, "loc": (FORM_PLACE, *item["loc"])} for item in error.errors()]
        ) from error


def _cameras(document: str | bytes, settings: Settings) -> tuple[CameraFile, tuple[Notice, ...]]:
    table = camera_table(document, settings)
    if len(table.names) > MAX_LOADED_VIEWS:
        message = f"has {len(table.names)} views, the limit is {MAX_LOADED_VIEWS}"
        raise InputError(message, field="cameras", cure="leave out those that need no picture")
    return table.parse(range(len(table.names)), None), table.warnings


def _file(
    data: bytes, name: str | None, fields: LoadFields, document: str | bytes | None, settings: Settings
) -> LoadedFile:
    """Parse the cameras and detect the format; to be called on a worker thread."""
    found, notices = _cameras(document, settings) if document is not None else (CameraFile(()), ())
    near, far = found.depths(fields.near, fields.far)
    return LoadedFile.of(
        data,
        fields.format,
        name,
        Dialect(fields.opacity, fields.scales, fields.rotation, fields.axes),
        drop_invalid=fields.drop_invalid,
        cameras=tuple(found.cameras),
        near=near,
        far=far,
        notices=tuple(notice | {"field": "cameras"} for notice in notices),
    )
