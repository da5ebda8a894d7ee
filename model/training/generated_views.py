"""Generated scenes as views of the service: cameras in px, pictures as they were rendered or rounded to 8 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.photographs.images import FittedView

from .scenes import SceneBatch

F32 = NDArray[np.float32]


def exact_views(batch: SceneBatch, scene: int = 0) -> list[FittedView]:
    """Inputs, then targets, of one scene of the batch, as they were rendered."""
    return [
        generated_view(*parts)
        for parts in zip(batch.images[scene], batch.intrinsics[scene], batch.world_from_cam[scene], strict=True)
    ]


def input_views(batch: SceneBatch, scene: int = 0) -> list[FittedView]:
    """The inputs alone, rounded as a file would hold them."""
    views = exact_views(batch, scene)[: batch.inputs]
    return [FittedView((np.rint(view.image * 255) / 255).astype(np.float32), None, view.camera, 1.0) for view in views]


def generated_view(image: F32, normalized: NDArray[np.float64], pose: NDArray[np.float64]) -> FittedView:
    """Of a picture (3, H, W), with K (3, 3) normalised by width and height."""
    height, width = image.shape[1:]
    fx, fy = normalized[0, 0] * width, normalized[1, 1] * height
    camera = Camera.make(width, height, fx, fy, normalized[0, 2] * width, normalized[1, 2] * height, pose)
    return FittedView(image, None, camera, 1.0)
