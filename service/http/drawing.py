"""Drawing pictures of a stored scene on a worker thread, within limits on pixels and time."""

from __future__ import annotations

import hashlib
import json
import time
from bisect import bisect_right
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from ..cameras.camera import Camera
from ..errors import DeadlineExceeded, InputError
from ..metrics import STAGES
from ..pictures.effort import Effort
from ..pictures.effort import draw as effort_draw
from ..pictures.picture import Channel
from ..revision import DRAWING_REVISION
from ..viewpoints.framing import frame
from ..viewpoints.scene_views import SceneViews
from .concurrency import Pause
from .files import etag_of
from .runtime import Runtime

if TYPE_CHECKING:
    from ..splat import Render


def check_size(camera: Camera, max_pixels: int, samples: int) -> Camera:
    """The camera itself. Raises `InputError` for a picture of more than `max_pixels` samples."""
    pixels = camera.width * camera.height * samples**2
    if pixels > max_pixels:
        fewer = "" if samples == 1 else " or fewer samples"
        largest = _largest(camera, max_pixels / samples**2)
        raise InputError(
            f"{camera.width} x {camera.height} with {samples} x {samples} samples = {pixels} px, "
            f"the limit is {max_pixels}",
            field="width",
            cure=f"ask for a smaller picture{fewer}, as with width={largest.width}&height={largest.height}",
        )
    return camera


def _largest(camera: Camera, pixels: float) -> Camera:
    """The camera at the greatest width, at least 1 px, at which its picture, of the same aspect, has at most so many
    pixels."""

    def pixels_at(width: int) -> int:
        smaller = frame(camera, width)
        return smaller.width * smaller.height

    return frame(camera, max(1, bisect_right(range(1, camera.width + 1), pixels, key=pixels_at)))


def draw(
    runtime: Runtime,
    scene_id: str,
    camera: Camera,
    views: SceneViews,
    channel: Channel = "rgb",
    effort: Effort | None = None,
    background: Sequence[float] | None = None,
) -> Render:
    """Render a stored scene, on a worker thread. Raises `DeadlineExceeded` after `picture_seconds`."""
    gaussians = runtime.store.gaussians(scene_id)
    limit = partial(_check_time, time.monotonic(), runtime.settings.picture_seconds)
    options = {"background": background, "threads": runtime.settings.threads, "between": limit, **views.near_plane}
    return effort_draw(gaussians, camera, channel, effort, **options)


def _check_time(begun: float, seconds: float) -> None:
    if time.monotonic() - begun > seconds:
        raise DeadlineExceeded(
            f"the picture was not drawn within {seconds:g} s",
            cure="ask for a smaller one, fewer samples, a larger alpha_min or stop, or a smaller cut_radius",
        )


class PictureSeries:
    """Several pictures of one scene, between which other requests of the queue may run; `seconds` sums up the time of
    waiting and drawing. The caller keeps the scene from eviction."""

    def __init__(
        self, runtime: Runtime, scene_id: str, views: SceneViews, background: Sequence[float] | None, pause: Pause
    ) -> None:
        self._draw = partial(draw, runtime, scene_id, views=views, background=background)
        self._pause = pause
        self._begun = False
        self.seconds = {"wait": 0.0, "draw": 0.0}

    def pixels(self, camera: Camera) -> NDArray[np.uint8]:
        """Draw the next picture, (H, W, 3) sRGB."""
        start = time.perf_counter()
        if self._begun:
            self._pause()
        self._begun = True
        turn = time.perf_counter()
        pixels = self._draw(camera=camera).rgb8()
        drawn = time.perf_counter() - turn
        STAGES.labels("draw").observe(drawn)
        self.seconds["wait"] += turn - start
        self.seconds["draw"] += drawn
        return pixels


def picture_tag(runtime: Runtime, scene_id: str, query: BaseModel) -> str:
    """Entity tag of a picture or film: a hash of the scene's tag, the query, and the version of the splatter."""
    with runtime.store.reading(scene_id) as path:
        scene = etag_of(path)
    parts = [scene, version("gapmes"), DRAWING_REVISION, type(query).__name__, query.model_dump_json(exclude={"scene"})]
    return f'"{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]}"'
