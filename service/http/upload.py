"""Parsing and checking the form of `POST /reconstruct`; no photograph is decoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import anyio.to_thread
from fastapi import Request
from starlette.datastructures import FormData, UploadFile

from ..cameras.depth_range import DepthRange, depth_range
from ..cameras.leave_one_out import DEFAULT_OTHERS, checked_others
from ..cameras.pose_notices import pose_notices
from ..cameras.view_checks import MAX_VIEWS, MIN_VIEWS, Notice, check_views
from ..captures.archive import SIGNATURES
from ..captures.select import ViewSelection, checked_selection
from ..errors import (
    DepthRangeError,
    InputError,
    MalformedRequest,
    UploadTooLarge,
    ViewCountError,
)
from ..jobs.work import Work
from ..leaving_out.budget import DEFAULT_CERTIFY, DEFAULT_MAX_ERROR, Budget, parse_max_error
from ..leaving_out.stride import STRIDES
from ..mending.detail_level import checked_detail
from ..mending.fade_passes import DEFAULT_PASSES, checked_passes
from ..model_names import DEFAULT, checked_name
from ..plain_number import counted
from ..settings import Settings
from ..viewpoints.scene_views import SceneViews
from .fields import flag, number, whole
from .form import FORM
from .inputs import CAMERA_FILES, Inputs, captured, posted
from .pairing import NamedImage, Pairing
from .posted import MAX_IMAGES, MAX_PARTS, no_file, posted_form, size_of
from .posted import single as _single
from .posted import text as _text

MAX_ASKED_VIEWS = 64  # in `views`: each is drawn, or linked
FIELDS = tuple(FORM["properties"])


@dataclass(frozen=True)
class Upload:
    """A checked form: images, still encoded, with their cameras, and the options."""

    pairing: Pairing
    selection: dict[str, Any]
    work: Work
    views: tuple[str, ...]  # to draw, such as "1.5"

    def check(self, settings: Settings) -> tuple[DepthRange, list[Notice]]:
        """The depth range, and the warnings about the cameras. Raises what a reconstruction would raise before it
        decodes a photograph, and `ViewError` for a requested view that does not exist."""
        views = SceneViews(self.pairing.cameras)
        for spec in self.views:
            views.resolve(spec, field="views")
        work, numbers = self.work, self.selection["views"]
        work.check_pixels(settings)
        depths = depth_range(work.cameras, work.near, work.far)
        warnings = check_views(work.cameras, depths, trust_poses=work.trust_poses, numbers=numbers)
        return depths, warnings + pose_notices(work.cameras, depths.near, numbers)


@dataclass(frozen=True)
class RequestSummary:
    """Members of the answer that are about the request itself."""

    images: tuple[str, ...]  # file names
    paired_by: str
    selection: dict[str, Any]  # which of the posted views are used, and why
    warnings: tuple[dict[str, Any], ...]
    views: tuple[str, ...]

    @classmethod
    def of(cls, upload: Upload) -> RequestSummary:
        """Of an upload, without keeping its photographs in memory."""
        pairing = upload.pairing
        names = tuple(image.name for image in pairing.images)
        return cls(names, pairing.by, upload.selection, pairing.warnings, upload.views)

    def document(self) -> dict[str, Any]:
        """As JSON values, for the document of a scene or of a job."""
        return {
            "images": list(self.images),
            "paired_by": self.paired_by,
            "selection": self.selection,
            "warnings": list(self.warnings),
        }


async def read_upload(request: Request, settings: Settings, models: Sequence[str]) -> Upload:
    """Read and check the form; `models` are the names that it may choose from. Raises errors of our own, which name the
    field.

    Cameras and image sizes are parsed on a worker thread.
    """
    example = "curl -F images=@a.jpg -F images=@b.jpg -F cameras=@cameras.json"
    try:
        async with posted_form(request, settings, example, _too_many(f"more than {MAX_PARTS} files")) as form:
            return await _parse(form, settings, models)
    except MalformedRequest as error:
        error.cure = error.cure or example
        raise


async def _parse(form: FormData, settings: Settings, models: Sequence[str]) -> Upload:
    for name in form:
        if name not in FIELDS:
            raise InputError("is not a field of this route", field=name[:100], cure=f"fields: {', '.join(FIELDS)}")
    model = checked_name(_text(form, "model") or DEFAULT, models)
    wanted = checked_selection(ViewSelection(_text(form, "select") or None, whole(form, "context", None)))
    views = _views(form)
    near, far = number(form, "near", DepthRangeError), number(form, "far", DepthRangeError)
    inputs = await _inputs(form, settings, wanted, near, far)
    pairing = inputs.pairing
    lenses = tuple(view.lens for view in pairing.views)
    numbers = tuple(inputs.selection["views"])  # as the client counts the views
    budget = _budget(form, views)
    work = Work(
        images=tuple(image.data for image in pairing.images),
        cameras=pairing.cameras,
        lenses=lenses if any(lens is not None for lens in lenses) else (),
        near=inputs.near,
        far=inputs.far,
        trust_poses=flag(form, "trust_poses"),
        refine_poses=flag(form, "refine_poses"),
        leave_one_out=checked_others(whole(form, "leave_one_out", DEFAULT_OTHERS)),
        fade=checked_passes(whole(form, "fade", DEFAULT_PASSES)),
        detail=checked_detail(whole(form, "detail", 1), budget.stride, settings.max_detail),
        budget=budget,
        model=model,
        numbers=numbers if numbers != tuple(range(len(numbers))) else (),
    )
    return Upload(pairing, inputs.selection, work, views)


def _budget(form: FormData, views: tuple[str, ...]) -> Budget:
    max_error = _text(form, "max_error")
    stride = _text(form, "stride")
    if stride not in ("", *map(str, STRIDES)):
        raise InputError(f"{stride[:50]!r} is none of {STRIDES}", field="stride", cure="leave it out for 1")
    return Budget(
        parse_max_error(max_error) if max_error else DEFAULT_MAX_ERROR,
        whole(form, "certify", DEFAULT_CERTIFY),
        views,
        number(form, "min_opacity") or 0.0,
        int(stride) if stride else 1,
    )


async def _inputs(
    form: FormData, settings: Settings, wanted: ViewSelection, near: float | None, far: float | None
) -> Inputs:
    capture = _single(form, "capture") or None  # an empty field counts as missing
    if capture is None:
        images = await _images(form, wanted)
        document = await _cameras(form, settings.max_camera_bytes)
        return await anyio.to_thread.run_sync(lambda: posted(document, images, wanted, settings, near, far))
    for name in ("images", "cameras"):
        if any(part != "" for part in form.getlist(name)):
            raise InputError(f"is given beside {name}", field="capture", cure="it holds photographs and cameras")
    if not isinstance(capture, UploadFile):
        raise no_file(capture, "capture", "curl -F capture=@capture.zip")
    stream = capture.file
    return await anyio.to_thread.run_sync(lambda: captured(stream, wanted, settings, near, far))


async def _images(form: FormData, wanted: ViewSelection) -> list[NamedImage]:
    parts = [part for part in form.getlist("images") if part != ""]  # an empty field counts as missing
    if len(parts) > MAX_IMAGES:
        raise _too_many(f"{len(parts)} images")
    files = []
    for index, part in enumerate(parts):
        if not isinstance(part, UploadFile):
            raise no_file(part, "images", "curl -F images=@a.jpg", index)
        files.append(part)
    few = len(parts) < MIN_VIEWS
    if few or (len(parts) > MAX_VIEWS and wanted.select is None and wanted.context is None):
        raise ViewCountError(
            f"{counted(len(parts), 'image')}, need {MIN_VIEWS} to {MAX_VIEWS}",
            field="images",
            cure="repeat the part `images`, once per photograph, or send a `capture`"
            if few
            else "of more, say with `context` how many to choose or with `select` which; or send a `capture`",
        )
    return [NamedImage(_encodable(file.filename or ""), await file.read()) for file in files]


def _too_many(what: str) -> ViewCountError:
    cure = "send a `capture`: one zip of the photographs and their cameras"
    return ViewCountError(f"{what}, need at most {MAX_IMAGES} images", field="images", cure=cure)


def _encodable(name: str) -> str:
    """Escape lone surrogates, which some charsets produce and UTF-8 cannot encode, as \\ud800."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


async def _cameras(form: FormData, max_bytes: int) -> str | bytes:
    part = _single(form, "cameras") or None  # an empty field counts as missing
    if part is None:
        raise InputError(
            "is missing",
            field="cameras",
            cure=CAMERA_FILES,
        )
    if isinstance(part, UploadFile) and await part.read(4) in SIGNATURES:
        max_bytes = size_of(part)  # its members are bounded when they are read
    if isinstance(part, UploadFile):
        await part.seek(0)
    size = size_of(part)
    if size > max_bytes:
        cure = "send the cameras of the posted images alone"
        raise UploadTooLarge(f"{size} bytes, the limit is {max_bytes}", field="cameras", cure=cure)
    return await part.read() if isinstance(part, UploadFile) else part


def _views(form: FormData) -> tuple[str, ...]:
    text = _text(form, "views")
    count = text.count(",") + 1
    if count > MAX_ASKED_VIEWS:
        cure = "ask for the others by GET /render"
        raise InputError(f"{count} views, need at most {MAX_ASKED_VIEWS}", field="views", cure=cure)
    return tuple(view.strip() for view in text.split(",")) if text else ()
