"""`GET /render`: a picture of a stored scene, from one of its views or from any camera."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Annotated, Any

import anyio.to_thread
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from ..cameras.camera import Camera
from ..cameras.camera_json import camera_from_json
from ..errors import ViewError
from ..metrics import STAGES
from ..pictures.effort import ALPHA_MIN, LIMITS, MAX_SAMPLES, STOP, Effort
from ..pictures.picture import Channel, Format, Picture, check_format, encode, parse_background
from ..problem_document import plain
from ..viewpoints.framing import frame
from ..viewpoints.scene_views import SceneViews
from .drawing import check_size, draw, picture_tag
from .files import matches, not_modified
from .limits import parse_json
from .parameters import Parameters
from .responses import head_alone, server_timing
from .runtime import Runtime, RuntimeDep

router = APIRouter(tags=["views"])

KEPT = "private, max-age=3600"  # for a named scene; limited, since another release may draw it differently


class RenderQuery(Parameters):
    """A picture."""

    view: str | None = Field(
        None,
        max_length=100,
        description="an input, between two, an orbit; default 0",
        examples=["2", "1.5", "orbit:30"],
    )
    camera: str | None = Field(None, max_length=10_000, description="any camera: one view object of cameras.json")
    scene: str | None = Field(None, max_length=200, description="id of the scene; default: the newest")
    width: int | None = Field(None, ge=1, le=65_535, description="px; with height alone the aspect stays")
    height: int | None = Field(None, ge=1, le=65_535, description="px; another aspect crops about the middle")
    channel: Channel = Field("rgb", description="colour, opacity or z-depth")
    format: Format = Field("png", description="alpha and depth: png or webp; depth has 16 bits in png, 8 in webp")
    depth_scale: float | None = Field(
        None, gt=0, description="of depth: the cameras' units per grey level; default: what the picture's depths need"
    )
    alpha_min: float = Field(
        ALPHA_MIN,
        ge=LIMITS["alpha_min"][0],
        le=LIMITS["alpha_min"][1],
        description="layers below this opacity are not drawn",
    )
    stop: float = Field(STOP, ge=0, le=LIMITS["stop"][1], description="what lies behind so little light is not drawn")
    cut_radius: float | None = Field(
        None,
        ge=LIMITS["cut_radius"][0],
        le=LIMITS["cut_radius"][1],
        description="standard deviations beyond which a Gaussian is not drawn; default: as far as alpha_min reaches",
    )
    sh_degree: int = Field(3, ge=0, le=3, description="highest band of harmonics")
    samples: int = Field(1, ge=1, le=MAX_SAMPLES, description="per side of a pixel")
    background: str = Field(
        "black", max_length=50, description="rrggbb in hex, or a name", examples=["white", "204080"]
    )


@router.head("/render", include_in_schema=False)
@router.get(
    "/render",
    response_class=Response,
    responses={
        200: {"content": {"image/png": {}, "image/webp": {}, "image/jpeg": {}}},
        304: {"description": "`If-None-Match` has the picture's tag"},
    },
)
async def render(request: Request, query: Annotated[RenderQuery, Query()], runtime: RuntimeDep) -> Response:
    """Draw a scene on the CPU; headers tell its id and what the splatter has left out."""
    if query.view is not None and query.camera is not None:
        raise ViewError("view and camera are both given, need one", field="camera")
    runtime.require_ready()
    with ExitStack() as held:  # until it is drawn
        asked = await anyio.to_thread.run_sync(_asked, runtime, query, held)
        cache = {"ETag": asked.etag, "Cache-Control": KEPT if query.scene is not None else "no-cache"}
        if matches(request, asked.etag):
            return not_modified(cache)
        if request.method == "HEAD":
            return head_alone(f"image/{query.format}", {"X-Gapmes-Scene": asked.scene_id, **cache})
        return await _drawn(request, runtime, query, asked, cache)


@dataclass(frozen=True, eq=False)
class _Asked:
    """A query, resolved against the store."""

    scene_id: str
    views: SceneViews
    camera: Camera
    background: tuple[float, float, float]
    etag: str


async def _drawn(
    request: Request, runtime: Runtime, query: RenderQuery, asked: _Asked, cache: Mapping[str, str]
) -> Response:
    effort = Effort(query.alpha_min, query.stop, query.sh_degree, query.samples, query.cut_radius)

    def work() -> tuple[Picture, dict[str, Any], float]:
        drawn = draw(runtime, asked.scene_id, asked.camera, asked.views, query.channel, effort, asked.background)
        start = time.perf_counter()
        return (
            encode(drawn, query.channel, query.format, query.depth_scale),
            plain(drawn.stats),
            time.perf_counter() - start,
        )

    start = time.perf_counter()
    picture, stats, encoding = await runtime.pictures.run(work, request.is_disconnected)
    total = time.perf_counter() - start
    drawing = sum(stats["seconds"].values())
    for stage, seconds in (("draw", drawing), ("encode", encoding)):
        STAGES.labels(stage).observe(seconds)
    timing = server_timing({"wait": max(total - drawing - encoding, 0.0), "draw": drawing, "encode": encoding})
    headers = {"X-Gapmes-Scene": asked.scene_id, "X-Gapmes-Stats": json.dumps(stats), "Server-Timing": timing, **cache}
    if picture.depth is not None:
        headers |= {f"X-Gapmes-Depth-{name}": repr(value) for name, value in picture.depth.named().items()}
    return Response(picture.data, media_type=picture.media_type, headers=headers)


def _asked(runtime: Runtime, query: RenderQuery, held: ExitStack) -> _Asked:
    """Resolve a query; `held` keeps the scene from eviction. To be called on a worker thread."""
    scene_id = query.scene if query.scene is not None else runtime.store.newest()
    held.enter_context(runtime.store.keeping(scene_id))
    views = SceneViews.of_document(runtime.store.document(scene_id))
    if query.camera is not None:
        camera = camera_from_json(parse_json(query.camera, "camera"))
    else:
        camera = views.resolve(query.view if query.view is not None else "0")
    camera = check_size(frame(camera, query.width, query.height), runtime.settings.max_render_pixels, query.samples)
    check_format(camera.width, camera.height, query.channel, query.format, query.depth_scale)
    background = parse_background(query.background)
    return _Asked(scene_id, views, camera, background, picture_tag(runtime, scene_id, query))
