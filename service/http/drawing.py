"""Drawing a stored scene within the service's bounds, on a worker thread: one picture, or one after the other."""

from __future__ import annotations

import hashlib
import json
import time
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
from ..viewpoints.scene_views import SceneViews
from .files import etag_of
from .gate import Pause
from .runtime import Runtime

if TYPE_CHECKING:
    from ..splat import Render


def check_size(camera: Camera, max_pixels: int, samples: int = 1) -> Camera:
    """Refuse a picture beyond the limit before anything of it is allocated."""
    pixels = camera.width * camera.height * samples**2
    if pixels > max_pixels:
        raise InputError(
            f"{camera.width} x {camera.height} with {samples} x {samples} samples = {pixels} px, "
            f"the limit is {max_pixels}",
            field="width",
            cure="ask for a smaller picture" if samples == 1 else "ask for a smaller picture or fewer samples",
        )
    return camera


def draw(
    runtime: Runtime,
    scene_id: str,
    camera: Camera,
    views: SceneViews,
    channel: Channel = "rgb",
    effort: Effort | None = None,
    background: Sequence[float] | None = None,
) -> Render:
    """Render a stored scene; call it on a worker thread. Raises `DeadlineExceeded` where that takes too long."""
    gaussians = runtime.store.gaussians(scene_id)
    limit = partial(_check_time, time.monotonic(), runtime.settings.picture_seconds)
    options = {"background": background, "threads": runtime.settings.threads, "between": limit, **views.near_plane}
    return effort_draw(gaussians, camera, channel, effort, **options)


def _check_time(begun: float, seconds: float) -> None:
    if time.monotonic() - begun > seconds:
        raise DeadlineExceeded(
            f"the picture was not drawn within {seconds:g} s",
            cure="ask for a smaller one, fewer samples, or a larger alpha_min or stop",
        )


class Sitting:
    """Pictures of one scene in one turn of the lane, between which it pauses; `seconds` has what it took. Whoever lets
    it draw keeps the scene meanwhile."""

    def __init__(
        self, runtime: Runtime, scene_id: str, views: SceneViews, background: Sequence[float] | None, pause: Pause
    ) -> None:
        self._draw = partial(draw, runtime, scene_id, views=views, background=background)
        self._pause = pause
        self._begun = False
        self.seconds = {"wait": 0.0, "draw": 0.0}

    def pixels(self, camera: Camera) -> NDArray[np.uint8]:
        """The next picture, (H, W, 3)."""
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
    """Of a picture or film: it depends on the scene's file, on what is asked, and on the splatter of this release."""
    with runtime.store.reading(scene_id) as path:
        scene = etag_of(path)
    parts = [scene, version("gapmes"), DRAWING_REVISION, type(query).__name__, query.model_dump_json(exclude={"scene"})]
    return f'"{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]}"'
