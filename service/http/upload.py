"""The multipart body of `POST /reconstruct`, read within its bounds and before anything of it is decoded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import anyio.to_thread
from fastapi import Request
from starlette.datastructures import FormData, UploadFile

from ..budget import DEFAULT_CERTIFY, DEFAULT_MAX_ERROR, Budget, parse_max_error
from ..camera_file import CameraFile, parse_camera_file
from ..errors import (
    DepthRangeError,
    InputError,
    UploadTooLarge,
    ViewCountError,
)
from ..foretold import DEFAULT_OTHERS, checked_others
from ..jobs.work import Work
from ..model_names import DEFAULT, checked_name
from ..settings import Settings
from ..stride import STRIDES
from ..view_checks import MAX_VIEWS, MIN_VIEWS
from .limits import parse_json
from .pairing import NamedImage, Pairing, PostedSizes, pair
from .posted import MAX_PARTS, posted_form
from .posted import single as _single
from .posted import text as _text

MAX_FRAMES = 2_000  # in a camera file, of which 6 at most are used; above it matching names takes seconds
FIELDS = (
    "images",
    "cameras",
    "near",
    "far",
    "views",
    "trust_poses",
    "max_error",
    "certify",
    "min_opacity",
    "stride",
    "leave_one_out",
    "model",
)


@dataclass(frozen=True)
class Upload:
    """What was posted: the images still encoded, each with its camera."""

    pairing: Pairing
    work: Work
    views: tuple[str, ...]  # to be drawn, such as "1.5"


@dataclass(frozen=True)
class Told:
    """What the answer says of the request itself."""

    images: tuple[str, ...]  # file names
    paired_by: str
    warnings: tuple[dict[str, Any], ...]
    views: tuple[str, ...]

    @classmethod
    def of(cls, upload: Upload) -> Told:
        """Without the photographs."""
        pairing = upload.pairing
        return cls(tuple(image.name for image in pairing.images), pairing.by, pairing.warnings, upload.views)


async def read_upload(request: Request, settings: Settings, models: Sequence[str] = (DEFAULT,)) -> Upload:
    """Read and check the form, where `models` are the names that it may choose from; raises the error that names the
    field, never a framework's own.

    What takes long, parsing the cameras and reading sizes, runs on a worker thread.
    """
    example = "curl -F images=@a.jpg -F images=@b.jpg -F cameras=@cameras.json"
    async with posted_form(request, settings, example) as form:
        return await _parse(form, settings, models)


async def _parse(form: FormData, settings: Settings, models: Sequence[str]) -> Upload:
    for name in form:
        if name not in FIELDS:
            raise InputError("is not a field of this route", field=name[:100], cure=f"fields: {', '.join(FIELDS)}")
    model = checked_name(_text(form, "model") or DEFAULT, models)
    images = await _images(form)
    document = await _cameras(form, settings.max_camera_bytes)
    sizes = PostedSizes(images, settings.max_image_pixels)
    cameras, pairing = await anyio.to_thread.run_sync(lambda: _paired(document, images, sizes))
    near, far = (_number(form, name, given) for name, given in (("near", cameras.near), ("far", cameras.far)))
    work = Work(
        images=tuple(image.data for image in pairing.images),
        cameras=pairing.cameras,
        near=near,
        far=far,
        trust_poses=_flag(form, "trust_poses"),
        leave_one_out=checked_others(_whole(form, "leave_one_out", DEFAULT_OTHERS)),
        budget=_budget(form),
        model=model,
    )
    return Upload(pairing, work, _views(form))


def _budget(form: FormData) -> Budget:
    max_error = _text(form, "max_error")
    min_opacity, stride = _text(form, "min_opacity"), _text(form, "stride")
    if stride not in ("", *map(str, STRIDES)):
        raise InputError(f"{stride[:50]!r} is none of {STRIDES}", field="stride")
    return Budget(
        parse_max_error(max_error) if max_error else DEFAULT_MAX_ERROR,
        _whole(form, "certify", DEFAULT_CERTIFY),
        _views(form),
        _finite(min_opacity, "min_opacity", InputError) if min_opacity else 0.0,
        int(stride) if stride else 1,
    )


def _paired(document: str | bytes, images: list[NamedImage], sizes: PostedSizes) -> tuple[CameraFile, Pairing]:
    obj = parse_json(document, "cameras")
    for name in ("views", "frames"):
        count = len(obj[name]) if isinstance(obj, dict) and isinstance(obj.get(name), list) else 0
        if count > MAX_FRAMES:
            raise InputError(
                f"has {count} {name}, the limit is {MAX_FRAMES}",
                field="cameras",
                cure="send the cameras of the posted images alone",
            )
    cameras = parse_camera_file(obj, size_of=sizes)
    return cameras, pair(images, cameras.views)


async def _images(form: FormData) -> list[NamedImage]:
    parts = form.getlist("images")
    files = []
    for index, part in enumerate(parts):
        if not isinstance(part, UploadFile):
            raise InputError(
                "is a text field, need a file part", field="images", index=index, cure="curl -F images=@a.jpg"
            )
        files.append(part)
    if not MIN_VIEWS <= len(parts) <= MAX_VIEWS:
        raise ViewCountError(
            f"{len(parts)} images, need {MIN_VIEWS} to {MAX_VIEWS}",
            field="images",
            cure="repeat the part `images`, once per photograph",
        )
    return [NamedImage(_encodable(file.filename or ""), await file.read()) for file in files]


def _encodable(name: str) -> str:
    """Lone surrogates, which some charsets let in and UTF-8 cannot hold, as text: \\ud800."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


async def _cameras(form: FormData, max_bytes: int) -> str | bytes:
    part = _single(form, "cameras")
    if part is None:
        raise InputError(
            "is missing", field="cameras", cure="send cameras.json or transforms.json as a field or as a file part"
        )
    size = (part.size or 0) if isinstance(part, UploadFile) else len(part)
    if size > max_bytes:
        raise UploadTooLarge(f"{size} bytes, the limit is {max_bytes}", field="cameras")
    return await part.read() if isinstance(part, UploadFile) else part


def _number(form: FormData, name: str, otherwise: float | None) -> float | None:
    text = _text(form, name)
    if not text:
        return otherwise
    return _finite(text, name, DepthRangeError)


def _whole(form: FormData, name: str, otherwise: int) -> int:
    text = _text(form, name)
    if text and not (text.isascii() and text.isdigit() and len(text) < 9):
        raise InputError(f"{text[:50]!r} is not a whole number", field=name)
    return int(text) if text else otherwise


def _finite(text: str, name: str, refusal: type[InputError]) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise refusal(f"{text[:100]!r} is not a number", field=name) from error
    if not math.isfinite(value):
        raise refusal(f"{value} is not finite", field=name)
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
