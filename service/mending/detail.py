"""A scene at a finer resolution than the network's: Gaussians subdivided and coloured by the photographs' own
pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.world_frame import WorldFrame
from ..network.engine import Arrays
from ..photographs.images import FittedView
from .finer_grid import on_finer_grid


def finer(outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], fine: Sequence[FittedView]) -> Arrays:
    """The outputs for `views` (V, H, W), upsampled to `fine`, the same pictures with k times the pixels per axis.

    Every pixel's Gaussian is split into k x k, k times smaller (`on_finer_grid`). Each adds to the base colour the
    difference of its fine pixel from the mean of the k x k, so that their mean colour stays.
    """
    k = fine[0].camera.width // views[0].camera.width
    shape = fine[0].image.shape[1:]
    return on_finer_grid(outputs, frame, views, shape, [_detail(view, k) for view in fine])


def _detail(view: FittedView, k: int) -> NDArray[np.float32]:
    """(kH, kW, 3) difference of each kept pixel from the mean of the kept pixels in its square of k x k; 0 if
    masked."""
    image = view.image.transpose(1, 2, 0)
    kept = view.kept.astype(np.float32)
    squares = (image.shape[0] // k, k, image.shape[1] // k, k)
    total = (image * kept[..., None]).reshape(*squares, 3).sum(axis=(1, 3))
    mean = total / np.maximum(kept.reshape(squares).sum(axis=(1, 3)), 1)[..., None]
    return (image - mean.repeat(k, axis=0).repeat(k, axis=1)) * kept[..., None]
