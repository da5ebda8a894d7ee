"""The multipart body of `POST /reconstruct`, read within its bounds and before anything of it is decoded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from fastapi import Request
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException

from ..camera_file import parse_camera_file
from ..errors import (
    DepthRangeError,
    InputError,
    MalformedRequest,
    UnsupportedMediaType,
    UploadTooLarge,
    ViewCountError,
)
from ..view_checks import MAX_VIEWS, MIN_VIEWS
from .limits import parse_json
from .pairing import NamedImage, Pairing, pair, posted_size

MAX_PARTS = 64  # far above what a valid request has, so that one image too many is told from a flood
FIELDS = ("images", "cameras", "near", "far", "views", "trust_poses")


@dataclass(frozen=True)
class Upload:
    """What was posted: the images still encoded, each with its camera."""

    pairing: Pairing
    near: float | None
    far: float | None
    views: tuple[str, ...]
    trust_poses: bool


async def read_upload(request: Request, *, max_camera_bytes: int, max_upload_bytes: int) -> Upload:
    """Read and check the form; raises the error that names the field, never a framework's own."""
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != "multipart/form-data":
        raise UnsupportedMediaType(
            f"the body is {media_type[:100] or 'of no declared type'}, need multipart/form-data",
            field="body",
            cure="curl -F images=@a.jpg -F images=@b.jpg -F cameras=@cameras.json",
        )
    try:
        form = await request.form(max_files=MAX_PARTS, max_fields=MAX_PARTS, max_part_size=max_upload_bytes)
    except HTTPException as error:
        raise MalformedRequest(f"the multipart body cannot be read: {error.detail}", field="body") from error
    try:
        return await _parse(form, max_camera_bytes)
    finally:
        await form.close()


async def _parse(form: FormData, max_camera_bytes: int) -> Upload:
    for name in form:
        if name not in FIELDS:
            raise InputError("is not a field of this route", field=name[:100], cure=f"fields: {', '.join(FIELDS)}")
    images = await _images(form)
    cameras = parse_camera_file(
        await _cameras(form, max_camera_bytes), size_of=lambda name, index: posted_size(images, name, index)
    )
    near, far = (_number(form, name, given) for name, given in (("near", cameras.near), ("far", cameras.far)))
    return Upload(pair(images, cameras.views), near, far, _views(form), _flag(form, "trust_poses"))


async def _images(form: FormData) -> list[NamedImage]:
    parts = form.getlist("images")
    for index, part in enumerate(parts):
        if not isinstance(part, UploadFile):
            raise InputError(
                "is a text field, need a file part", field="images", index=index, cure="curl -F images=@a.jpg"
            )
    if not MIN_VIEWS <= len(parts) <= MAX_VIEWS:
        raise ViewCountError(
            f"{len(parts)} images, need {MIN_VIEWS} to {MAX_VIEWS}",
            field="images",
            cure="repeat the part `images`, once per photograph",
        )
    return [NamedImage(part.filename or "", await part.read()) for part in parts]


async def _cameras(form: FormData, max_bytes: int) -> Any:
    part = _single(form, "cameras")
    if part is None:
        raise InputError(
            "is missing", field="cameras", cure="send cameras.json or transforms.json as a field or as a file part"
        )
    size = (part.size or 0) if isinstance(part, UploadFile) else len(part)
    if size > max_bytes:
        raise UploadTooLarge(f"{size} bytes, the limit is {max_bytes}", field="cameras")
    return parse_json(await part.read() if isinstance(part, UploadFile) else part, "cameras")


def _number(form: FormData, name: str, otherwise: float | None) -> float | None:
    text = _text(form, name)
    if not text:
        return otherwise
    try:
        value = float(text)
    except ValueError as error:
        raise DepthRangeError(f"{text[:100]!r} is not a number", field=name) from error
    if not math.isfinite(value):
        raise DepthRangeError(f"{value} is not finite", field=name)
    return value


def _flag(form: FormData, name: str) -> bool:
    text = _text(form, name).lower()
    if text not in ("", "false", "true"):
        raise InputError(f"{text[:100]!r} is neither true nor false", field=name)
    return text == "true"


def _views(form: FormData) -> tuple[str, ...]:
    text = _text(form, "views")
    views = tuple(view.strip() for view in text.split(",")) if text else ()
    if len(views) > MAX_PARTS:
        raise InputError(f"{len(views)} views, need at most {MAX_PARTS}", field="views")
    return views


def _text(form: FormData, name: str) -> str:
    part = _single(form, name)
    if isinstance(part, UploadFile):
        raise InputError("is a file part, need a text field", field=name)
    return (part or "").strip()


def _single(form: FormData, name: str) -> UploadFile | str | None:
    parts = form.getlist(name)
    if len(parts) > 1:
        raise InputError(f"is given {len(parts)} times, need once", field=name)
    return parts[0] if parts else None
