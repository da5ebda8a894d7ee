"""What two results look like: both are drawn, and the pictures compared."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gapmes.service.camera import Camera
from gapmes.service.contract import GAUSSIAN_OUTPUTS
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import render

from .cases import Case

NEAR_SHARE = 0.05  # of the scene's near depth


def picture_psnr(values: Mapping[str, NDArray], reference: Mapping[str, NDArray], case: Case) -> float:
    """PSNR in dB between the pictures of both at a pose half-way between the first two views; 200 when identical."""
    camera = between(case)
    near = NEAR_SHARE * float(case.inputs.near_far[0])
    pictures = [
        np.clip(render(Gaussians.make(*(result[n] for n in GAUSSIAN_OUTPUTS)), camera, near=near).rgb, 0, 1)
        for result in (values, reference)
    ]
    error = float(np.square(pictures[0].astype(np.float64) - pictures[1]).mean())
    return min(200.0, -10 * math.log10(error)) if error > 0 else 200.0


def between(case: Case) -> Camera:
    """The first camera moved half-way towards the second."""
    height, width = case.inputs.images.shape[-2:]
    k = case.inputs.intrinsics[0].double().numpy()
    pose = case.inputs.world_from_cam[0].double().numpy().copy()
    pose[:3, 3] = case.inputs.world_from_cam[:2, :3, 3].double().mean(0).numpy()
    return Camera.make(width, height, k[0, 0] * width, k[1, 1] * height, k[0, 2] * width, k[1, 2] * height, pose)
