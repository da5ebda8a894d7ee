"""Drawing a stored scene within the service's bounds, on a worker thread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..camera import Camera
from ..errors import InputError
from ..scene_views import SceneViews
from .runtime import Runtime

if TYPE_CHECKING:
    from ..splat import Render


def check_size(camera: Camera, max_pixels: int) -> Camera:
    """Refuse a picture beyond the limit before anything of it is allocated."""
    pixels = camera.width * camera.height
    if pixels > max_pixels:
        raise InputError(
            f"{camera.width} x {camera.height} = {pixels} px, the limit is {max_pixels}",
            field="width",
            cure="ask for a smaller picture",
        )
    return camera


def draw(
    runtime: Runtime, scene_id: str, camera: Camera, views: SceneViews, background: Sequence[float] | None = None
) -> Render:
    """Render a stored scene; call it on a worker thread."""
    from ..splat import render

    gaussians = runtime.store.gaussians(scene_id)
    return render(gaussians, camera, background=background, threads=runtime.settings.threads, **views.near_plane)
