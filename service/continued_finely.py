"""Planes continued on a grid finer than the photographs' pixels, with windows and steps so much narrower."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .continued import continued
from .depth_grid import coarser_depths, finer_depths
from .images import FittedView

F64 = NDArray[np.float64]

FINER = 2  # pixels in the place of one, each way


def continued_finely(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths after `continued` on photographs enlarged by FINER; of each pixel's the median."""
    fine = [_enlarged(view) for view in views]
    moved = continued(fine, np.stack([finer_depths(depth, FINER) for depth in depths]))
    return coarser_depths(moved, FINER)


def _enlarged(view: FittedView) -> FittedView:
    """Between its pixels by cubic convolution; the mask keeps whole pixels."""
    height, width = (FINER * side for side in view.image.shape[1:])
    channels = [
        np.asarray(Image.fromarray(channel).resize((width, height), Image.Resampling.BICUBIC)) for channel in view.image
    ]
    mask = None if view.mask is None else view.mask.repeat(FINER, axis=0).repeat(FINER, axis=1)
    return FittedView(np.clip(np.stack(channels), 0, 1), mask, view.camera.resized(width, height), view.kept_share)
