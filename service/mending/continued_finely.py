"""Plane continuation at a finer resolution than the photographs', so that all windows and reaches are smaller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..cameras.camera import Camera
from ..photographs.images import FittedView
from .continued import continued
from .depth_grid import coarser_depths, finer_depths

F64 = NDArray[np.float64]

FINER = 2  # upsampling factor per axis


def continued_finely(views: Sequence[FittedView], depths: F64) -> F64:
    """(V, H, W) z-depths after `continued` on photographs upsampled by FINER, reduced by `coarser_depths`."""
    fine = [_enlarged(view) for view in views]
    height, width = fine[0].image.shape[1:]
    moved = continued(fine, np.stack([finer_depths(depth, height, width) for depth in depths]))
    return coarser_depths(moved, FINER)


def _enlarged(view: FittedView) -> FittedView:
    """`view` upsampled by FINER, bicubic, from kept pixels alone; the mask is repeated without interpolation."""
    camera = view.camera.resized(FINER * view.camera.width, FINER * view.camera.height)
    step = view.step / FINER
    if view.mask is None:
        return replace(view, image=np.clip(_resized(view.image, camera), 0, 1), camera=camera, step=step)
    mask = view.mask.repeat(FINER, axis=0).repeat(FINER, axis=1)
    kept = view.mask.astype(np.float32)
    weight = np.where(mask, _resized(kept[None], camera), np.float32(1))
    image = np.where(mask, np.clip(_resized(view.image * kept, camera) / weight, 0, 1), np.float32(0))
    return replace(view, image=image, mask=mask, camera=camera, step=step)


def _resized(channels: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """`channels` (C, h, w) resampled to (C, H, W), the size of `camera`; bicubic."""
    size = camera.width, camera.height
    large = [Image.fromarray(channel).resize(size, Image.Resampling.BICUBIC) for channel in channels]
    return np.stack([np.asarray(channel) for channel in large])
