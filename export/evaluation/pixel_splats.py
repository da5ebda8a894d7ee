"""Rendering of depth maps: one small isotropic splat per input pixel, by the service's own splatter."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera, pixel_grid
from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.photographs.images import FittedView
from gapmes.service.splat import render
from gapmes.service.splat.definition import Definition

F32 = NDArray[np.float32]

RADIUS = 0.45  # standard deviation in pixels of the input at the splat's depth
OPACITY = 0.85
DILATION = 0.1  # px^2; with RADIUS a blur of 0.55 px, and no gap between neighbours at equal size
DOUBT = 0.15  # factor on the opacity of untrusted depths
SOLID = 0.5  # opacity from which on a pixel shows the splats alone


def pixel_gaussians(views: Sequence[FittedView], depths: F32, trusted: NDArray[np.bool_] | None = None) -> Gaussians:
    """Isotropic Gaussians at z-depths (V, H, W) with the pixels' colours; fainter where not `trusted` (V, H, W)."""
    means, scales, colours = [], [], []
    for view, depth in zip(views, depths, strict=True):
        camera, z = view.camera, depth.astype(np.float64).ravel()
        means.append(camera.unproject(pixel_grid(depth.shape), z))
        scales.append(RADIUS * z / math.sqrt(camera.fx * camera.fy))
        colours.append(view.image.reshape(3, -1).T)
    opacities = np.full(depths.size, OPACITY)
    if trusted is not None:
        opacities[~trusted.ravel()] *= DOUBT
    return Gaussians.make(
        means=np.concatenate(means),
        scales=np.repeat(np.concatenate(scales)[:, None], 3, axis=1),
        rotations_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (depths.size, 1)),
        opacities=opacities,
        harmonics=((np.concatenate(colours) - 0.5) / C0)[:, None],
    )


def drawn_over(gaussians: Gaussians, camera: Camera, behind: F32, near: float, threads: int | None) -> F32:
    """(3, H, W) in [0, 1]: the splats' unpremultiplied colour, blended with `behind` (3, H, W) below opacity SOLID."""
    picture = render(gaussians, camera, definition=Definition(dilation=DILATION, near=near), threads=threads)
    alpha = picture.alpha
    share = np.clip(alpha / SOLID, 0, 1)
    colour = picture.rgb.transpose(2, 0, 1) / np.maximum(alpha, 1e-3)
    return np.clip(share * colour + (1 - share) * behind, 0, 1).astype(np.float32)
