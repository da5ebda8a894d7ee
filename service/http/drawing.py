"""Drawing a stored scene within the service's bounds, on a worker thread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..camera import Camera
from ..effort import Effort
from ..effort import draw as effort_draw
from ..errors import InputError
from ..picture import Channel
from ..scene_views import SceneViews
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
    """Render a stored scene; call it on a worker thread."""
    gaussians = runtime.store.gaussians(scene_id)
    options = {"background": background, "threads": runtime.settings.threads, **views.near_plane}
    return effort_draw(gaussians, camera, channel, effort, **options)
