"""`GET /scenes/{id}/preview` and `/sheet`: a small film of a scene, and a contact sheet of its input views."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from ..cameras.camera import Camera
from ..errors import InputError
from ..pictures.contact_sheet import CELL, Cell, contact_sheet, rows_of
from ..pictures.film import MEDIA_TYPES, FilmFormat, FilmShape, check_film, write_film
from ..pictures.picture import Format, encode_image, parse_background
from ..process.own_folder import own_folder
from ..process.temporary_folder import temporary_files
from ..viewpoints.camera_path import PathName, loop
from ..viewpoints.framing import even, frame, within
from ..viewpoints.scene_views import SceneViews
from .concurrency import Pause
from .drawing import PictureSeries, picture_tag
from .files import matches, not_modified
from .parameters import Parameters
from .render import KEPT
from .responses import head_alone, server_timing
from .runtime import Runtime, RuntimeDep

router = APIRouter(tags=["views"])

Colour = tuple[float, float, float]

SIDE = 256  # px, default for the longer side of a film
MAX_FRAMES = 120
FILMS = "gapmes-film-"  # prefix of the temporary folders


class _SceneQuery(Parameters):
    background: str = Field(
        "black", max_length=50, description="rrggbb in hex, or a name", examples=["white", "204080"]
    )


class PreviewQuery(_SceneQuery):
    """A film."""

    path: PathName = Field("turntable", description="about the scene, through the inputs and back, or all round it")
    format: FilmFormat = Field("webp", description="webp and gif begin anew by themselves")
    frames: int = Field(24, ge=2, le=MAX_FRAMES, description="how many pictures")
    seconds: float = Field(2.0, ge=0.5, le=20, description="how long it lasts")
    width: int | None = Field(None, ge=2, le=4096, description="px; with height alone the aspect stays")
    height: int | None = Field(None, ge=2, le=4096, description="px; another aspect crops about the middle")
    swing: float | None = Field(
        None, gt=0, le=180, description="of a turntable: degrees each way; default: as far as the inputs reach"
    )


class SheetQuery(_SceneQuery):
    """A contact sheet."""

    format: Format = Field("png", description="of the picture")


@router.head("/scenes/{scene_id:path}/preview", include_in_schema=False)
@router.get(
    "/scenes/{scene_id:path}/preview",
    response_class=Response,
    responses={
        200: {"content": {kind: {} for kind in MEDIA_TYPES.values()}},
        304: {"description": "`If-None-Match` has the film's tag"},
    },
)
async def preview(
    request: Request, scene_id: str, query: Annotated[PreviewQuery, Query()], runtime: RuntimeDep
) -> Response:
    """Draw a film of the scene on the CPU, picture by picture; stops when the client disconnects."""

    def asked(held: ExitStack) -> tuple[SceneViews, FilmShape, list[Camera], Colour, str]:
        held.enter_context(runtime.store.keeping(scene_id))
        views = SceneViews.of_document(runtime.store.document(scene_id))
        background = parse_background(query.background)
        cameras = [_framed(camera, query) for camera in loop(views.path(query.path, query.swing), query.frames)]
        shape = FilmShape(query.format, cameras[0].width, cameras[0].height, query.frames, query.seconds)
        check_film(shape)
        _check_cost(cameras, runtime.settings.max_render_pixels, "frames", "ask for fewer, or smaller ones")
        return views, shape, cameras, background, picture_tag(runtime, scene_id, query)

    runtime.require_ready()
    with ExitStack() as held:  # until the last picture is drawn
        views, shape, cameras, background, etag = await anyio.to_thread.run_sync(asked, held)

        def work(series: PictureSeries) -> bytes:
            with temporary_files("the film"), own_folder(FILMS) as folder:
                path = folder / f"film.{shape.format}"
                write_film(path, shape, map(series.pixels, cameras))
                return path.read_bytes()

        begin = partial(PictureSeries, runtime, scene_id, views, background)
        return await _answer(request, runtime, etag, MEDIA_TYPES[shape.format], begin, work)


@router.head("/scenes/{scene_id:path}/sheet", include_in_schema=False)
@router.get(
    "/scenes/{scene_id:path}/sheet",
    response_class=Response,
    responses={
        200: {"content": {"image/png": {}, "image/webp": {}, "image/jpeg": {}}},
        304: {"description": "`If-None-Match` has the picture's tag"},
    },
)
async def sheet(
    request: Request, scene_id: str, query: Annotated[SheetQuery, Query()], runtime: RuntimeDep
) -> Response:
    """Draw the scene from its input cameras, side by side, each with its PSNR to the photograph.

    A scene that was loaded from a file has no photographs and therefore no PSNR.
    """

    def asked(held: ExitStack) -> tuple[dict[str, Any], SceneViews, list[Camera], Colour, str]:
        held.enter_context(runtime.store.keeping(scene_id))
        document = runtime.store.document(scene_id)
        views = SceneViews.of_document(document)
        cameras = [within(camera, CELL) for camera in views.cameras]
        _check_cost(cameras, runtime.settings.max_render_pixels, "scene", "draw its views one by one: GET /render")
        return document, views, cameras, parse_background(query.background), picture_tag(runtime, scene_id, query)

    runtime.require_ready()
    with ExitStack() as held:
        document, views, cameras, background, etag = await anyio.to_thread.run_sync(asked, held)
        check = document.get("check")  # a loaded scene has none
        title = "Inputs, drawn again" if check else "Views"
        scores = [view["psnr"] for view in check["input_views"]] if check else [None] * len(cameras)

        def work(series: PictureSeries) -> bytes:
            cells = []
            for index, (camera, score) in enumerate(zip(cameras, scores, strict=True)):
                like = "" if score is None else f"   {score:.1f} dB PSNR"  # no pixel to compare under its mask
                cells.append(Cell(series.pixels(camera), f"view {index}{like}"))
            return encode_image(contact_sheet(rows_of(title, cells)), query.format)

        begin = partial(PictureSeries, runtime, scene_id, views, background)
        return await _answer(request, runtime, etag, f"image/{query.format}", begin, work)


async def _answer(
    request: Request,
    runtime: Runtime,
    etag: str,
    media_type: str,
    begin: Callable[[Pause], PictureSeries],
    work: Callable[[PictureSeries], bytes],
) -> Response:
    """The response with what `work` draws in the queue of pictures, or 304; nothing is drawn for HEAD."""
    cache = {"ETag": etag, "Cache-Control": KEPT}
    if matches(request, etag):
        return not_modified(cache)
    if request.method == "HEAD":
        return head_alone(media_type, cache)

    def timed(pause: Pause) -> tuple[bytes, dict[str, float]]:
        series, start = begin(pause), time.perf_counter()
        data = work(series)
        seconds = series.seconds
        return data, seconds | {"encode": time.perf_counter() - start - sum(seconds.values())}

    start = time.perf_counter()
    data, seconds = await runtime.pictures.run_in_steps(timed, request.is_disconnected)
    seconds["wait"] += max(time.perf_counter() - start - sum(seconds.values()), 0.0)
    return Response(data, media_type=media_type, headers={"Server-Timing": server_timing(seconds), **cache})


def _framed(camera: Camera, query: PreviewQuery) -> Camera:
    """The camera at the requested size. For MP4 odd sides are cropped to even ones unless they were requested."""
    sides = query.width, query.height
    framed = within(camera, SIDE) if sides == (None, None) else frame(camera, *sides)
    odd = any(side is not None and side % 2 for side in sides)
    return even(framed) if query.format == "mp4" and not odd else framed


def _check_cost(cameras: Sequence[Camera], max_pixels: int, field: str, cure: str) -> None:
    """Raises `InputError` for pictures with more pixels in all than one of /render may have."""
    pixels = sum(camera.width * camera.height for camera in cameras)
    if pixels > max_pixels:
        largest = max(cameras, key=lambda camera: camera.width * camera.height)
        raise InputError(
            f"{len(cameras)} pictures of up to {largest.width} x {largest.height} are {pixels} px, "
            f"the limit is {max_pixels}",
            field=field,
            cure=cure,
        )
