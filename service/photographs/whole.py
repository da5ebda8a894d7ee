"""The pixel grid of a scene: that of the network, extended to the aspect of the photographs, and reduced to it again.

The network takes pictures of one shape. Photographs of another one are resampled to it as a whole, with pixels that are
longer one way, rather than cropped: what only the margins show would be lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..cameras.camera import Camera
from ..network.model_info import PATCH_PX
from .images import FittedView
from .resampling import resampled

MOST = 2.0  # length of the network's pixels by their width; more is cropped
Shape = tuple[int, int]  # height and width, px


def view_shapes(cameras: Sequence[Camera], turns: Sequence[int], network: Shape) -> list[Shape]:
    """Shape of each photograph in a scene by a network of this shape, which has each after so many quarter `turns`.

    All have the same shape after turning: the network's along one axis, and along the other the multiple of its patches
    that comes nearest to the aspect of the photographs. Of several aspects, this is the geometric mean of the least and
    the largest, so that the photograph that is cropped most keeps as much as it can.
    """
    aspects = [
        camera.height / camera.width if turn % 2 else camera.width / camera.height
        for camera, turn in zip(cameras, turns, strict=True)
    ]
    height, width = network
    longer = math.sqrt(min(aspects) * max(aspects)) * height / width
    longer = min(max(longer, 1 / MOST), MOST)
    if longer > 1:
        width = _patches(longer * width)
    else:
        height = _patches(height / longer)
    return [(width, height) if turn % 2 else (height, width) for turn in turns]


def _patches(pixels: float) -> int:
    return PATCH_PX * round(pixels / PATCH_PX)


def squeezed(view: FittedView, height: int, width: int) -> FittedView:
    """`view` resampled as a whole to `height` x `width` px, whatever its aspect; the view itself if it has that
    size."""
    camera = view.camera
    if (camera.height, camera.width) == (height, width):
        return view
    box = (0, 0, camera.width, camera.height)
    rgb, mask = resampled(view.pixels()[..., :3], view.mask, (width, height), box)
    image = np.ascontiguousarray(rgb.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)
    return replace(view, image=image, mask=mask, camera=camera.resized(width, height))
