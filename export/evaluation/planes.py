"""Baselines without a depth map: the nearest input unchanged, and all inputs warped through the best single plane."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
import torch
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.overlap import inverse_depth_steps
from gapmes.service.photographs.images import FittedView

from .warp import warped

F32 = NDArray[np.float32]

PLANES = 64
UNSEEN_WEIGHT = 1e-3  # of an input that does not see the point; its border colour then shows where no other sees it
NEAREST_SHARE = 1e-3  # of the summed distances; keeps the weight of an input at the target's own place finite


def nearest_input(inputs: Sequence[FittedView], camera: Camera) -> F32:
    """(3, H, W) of the input whose camera centre is closest."""
    return inputs[int(np.argmin(_distances(inputs, camera)))].image


def consistent_plane(inputs: Sequence[FittedView], near: float, far: float) -> float:
    """The z-depth, of `PLANES` uniform in inverse depth, at which the inputs warped onto each other agree best.

    Planes are fronto-parallel to the reference view. The cost is the mean absolute difference over all ordered pairs
    and pixels, with border colours outside of the source, so that little overlap is no advantage. Targets are not used.
    """
    depths = torch.from_numpy(inverse_depth_steps(near, far, PLANES).astype(np.float32))
    cost = torch.zeros(PLANES)
    for view, other in permutations(inputs, 2):
        colours, _ = warped(view.camera, other, depths.reshape(-1, 1, 1))
        cost += (colours - torch.from_numpy(view.image)).abs().mean(dim=(1, 2, 3))
    return float(depths[cost.argmin()])


def plane_blend(inputs: Sequence[FittedView], camera: Camera, depth: float) -> F32:
    """(3, H, W) all inputs warped through the plane at z-depth `depth` of `camera`, weighted by inverse distance."""
    distances = _distances(inputs, camera)
    shares = distances / max(float(distances.sum()), np.finfo(np.float64).tiny)
    total, weights = torch.zeros(3, camera.height, camera.width), torch.zeros(camera.height, camera.width)
    for view, share in zip(inputs, shares, strict=True):
        colours, seen = warped(camera, view, torch.full((1, 1, 1), depth))
        weight = (seen[0] + UNSEEN_WEIGHT) / (share + NEAREST_SHARE)
        total += colours[0] * weight
        weights += weight
    return (total / weights).numpy()


def _distances(inputs: Sequence[FittedView], camera: Camera) -> NDArray[np.float64]:
    return np.array([np.linalg.norm(view.camera.center - camera.center) for view in inputs])
