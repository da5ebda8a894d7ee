"""Photographs and cameras of a request, as `images` and `cameras` or in one `capture`, and the selection of views."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, BinaryIO

from ..cameras.camera_fields import CameraFile
from ..cameras.view_checks import check_count
from ..captures.archive import SIGNATURES, ZipFiles
from ..captures.capture import Capture
from ..captures.choose import chosen_views
from ..captures.recognise import BEFORE_JSON, recognised, table_of_bytes
from ..captures.select import ViewSelection, several_named_views
from ..captures.table import CameraTable
from ..captures.usable import usable_views
from ..errors import CameraError, CaptureError, InputError, MalformedRequest, UploadTooLarge
from ..settings import Settings
from .limits import parse_json
from .pairing import NamedImage, Pairing, PostedSizes, match_names

MAX_LISTED_VIEWS = 2_000  # in a camera file; more would take seconds to match by name
CAMERA_FILES = "send cameras.json, transforms.json, poses_bounds.npy, a RealEstate10K .txt or a zipped COLMAP model"
ZIPPED = 4  # times `max_camera_bytes`, for a camera file in a zip, which may list a whole capture
UNPACKED = 8  # times `max_upload_bytes`, for all unpacked files: COLMAP models shrink to about a third


@dataclass(frozen=True)
class Inputs:
    """Up to six encoded photographs with their views."""

    pairing: Pairing
    near: float | None
    far: float | None
    selection: dict[str, Any]  # JSON values: which of the posted views these are, and why


@contextmanager
def _cured() -> Iterator[None]:
    """Add a hint to errors about the camera file that have none of their own."""
    try:
        yield
    except (CameraError, MalformedRequest) as error:
        error.cure = error.cure or "GET /openapi.json has an example of `cameras`"
        raise


@_cured()
def posted(
    document: str | bytes,
    images: Sequence[NamedImage],
    wanted: ViewSelection,
    settings: Settings,
    near: float | None,
    far: float | None,
) -> Inputs:
    """Inputs from `images` parts and a `cameras` part of any format; `near` and `far` override the file's."""
    table = camera_table(document, settings)
    _check_listed(table, "cameras")
    names = [image.name for image in images]
    match = match_names(names, table.names, by_sorted_name=table.by_sorted_name)
    sizes = PostedSizes(images, match, settings.max_image_pixels)

    def cameras(places: Sequence[int]) -> CameraFile:
        return table.parse([match.cameras[place] for place in places], sizes)

    warnings = (*(notice | {"field": "cameras"} for notice in table.warnings), *match.warnings)
    said: dict[str, Any] = {"by": "all", "format": table.kind, "cameras": table.source, "of": len(images)}
    if wanted.select is not None:
        places = several_named_views(wanted.select, names, field=wanted.field)
        file, said = cameras(places), said | {"by": "select"}
    elif wanted.context is not None:
        there, file, refused = usable_views(range(len(images)), cameras)
        choice = chosen_views(file.cameras, wanted.context, file.middles(near, far))
        places, file = [there[place] for place in choice.places], file.chosen(choice.places)
        warnings, said = (*warnings, *refused), said | {"by": "score", **choice.said}
    else:
        places = list(range(len(images)))
        file = cameras(places)
    check_count(len(places))
    pairing = Pairing(tuple(images[place] for place in places), file.views, match.by, warnings)
    said |= {"views": places, "images": [image.name for image in pairing.images]}
    return Inputs(pairing, *file.depths(near, far), said)


@_cured()
def captured(
    stream: BinaryIO, wanted: ViewSelection, settings: Settings, near: float | None, far: float | None
) -> Inputs:
    """The inputs from a zip of photographs and cameras; `near` and `far` override those of the camera file."""
    if stream.read(4) not in SIGNATURES:
        raise CaptureError("is not a zip", field="capture", cure="zip the photographs with their camera file")
    files = ZipFiles(stream, max_bytes=UNPACKED * settings.max_upload_bytes)
    most = ZIPPED * settings.max_camera_bytes
    capture = Capture.of(files, max_pixels=settings.max_image_pixels, max_camera_bytes=most)
    _check_listed(capture.table, "capture")
    found = capture.choose(wanted, near, far)
    check_count(len(found.indices))
    size = sum(files.size(path) for path in found.paths)
    if size > settings.max_upload_bytes:  # by the zip's directory; a member that is longer is refused while it is read
        raise UploadTooLarge(
            f"the chosen photographs unpack to {size} bytes, the limit is {settings.max_upload_bytes}",
            field="capture",
            cure="choose fewer with `select` or `context`, or send smaller photographs",
        )
    images = [NamedImage(path, found.read(place)) for place, path in enumerate(found.paths)]
    by = "sorted name" if capture.by_sorted_name else "name"
    pairing = Pairing(tuple(images), found.file.views, by, found.warnings)
    return Inputs(pairing, *found.file.depths(near, far), found.selection)


def _json(document: str | bytes, data: bytes) -> Any:
    """The document as JSON. Raises `MalformedRequest`, which names all formats for what was not meant to be JSON."""
    try:
        return parse_json(document, "cameras")
    except MalformedRequest as error:
        if data.lstrip(BEFORE_JSON)[:1] not in b"{[":
            error.cure = CAMERA_FILES  # one file of a COLMAP model, say
        raise


@_cured()
def camera_table(document: str | bytes, settings: Settings) -> CameraTable:
    """The cameras of a `cameras` part of any format, including a zip of a COLMAP model."""
    data = document.encode("utf-8", "replace") if isinstance(document, str) else document
    if not data.startswith(SIGNATURES):
        return table_of_bytes(data, "cameras", lambda _: _json(document, data))
    try:
        files = ZipFiles(io.BytesIO(data), max_bytes=UNPACKED * settings.max_upload_bytes)
        return recognised(files, ZIPPED * settings.max_camera_bytes)[1]
    except CaptureError as error:
        error.field = "cameras"
        raise


def _check_listed(table: CameraTable, field: str) -> None:
    if len(table.names) > MAX_LISTED_VIEWS:
        raise InputError(
            f"has {len(table.names)} views, the limit is {MAX_LISTED_VIEWS}",
            field=field,
            cure="send the cameras of the posted images alone",
        )
