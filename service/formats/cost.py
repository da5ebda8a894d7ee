"""The loss of a format: PSNR between pictures of the original Gaussians and of those read back."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..cameras.camera import Camera
from ..gaussians import Gaussians
from ..pictures.picture_error import psnr
from ..viewpoints.scene_views import NearPlane


def picture_psnr(
    source: Gaussians,
    kept: Gaussians,
    cameras: Sequence[Camera],
    near_plane: NearPlane,
    *,
    threads: int | None = None,
    step: Callable[[int], None] = lambda done: None,
) -> list[float | None]:
    """PSNR in dB per camera over all pixels, on black, with colours clipped to [0, 1]; 100 for equal pictures, None if
    both are empty."""
    from ..splat import render

    values: list[float | None] = []
    for camera in cameras:
        drawn = [render(some, camera, threads=threads, outputs=(), **near_plane) for some in (source, kept)]
        seen = any(picture.stats["projected"] for picture in drawn)
        values.append(psnr(*(np.clip(picture.rgb, 0.0, 1.0) for picture in drawn)) if seen else None)
        step(len(values))
    return values
