"""Anchors: renders of the confirmed surfaces from cameras between the inputs, which novel views must still show.

A Gaussian of a dark or plain surface matches the photographs at many depths, and one that a single photograph shows at
any depth. Too near, it contradicts no input, but from between them it occludes what two of them have confirmed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.spanning_tree import minimum_spanning_tree
from ..gaussians import Gaussians
from ..leaving_out.certified import views_between
from ..photographs.images import FittedView
from ..splat import render

BETWEEN = 2  # cameras between two inputs that are neighbours
COVERED = 0.9  # opacity above which a pixel is part of an anchor


@dataclass(frozen=True, eq=False)
class Anchors:
    """Renders of the confirmed Gaussians, and which Gaussians must not occlude them."""

    pictures: tuple[FittedView, ...]  # masked where they are not covered
    may_fade: NDArray[np.bool_]  # (N,) Gaussians that may lose opacity for them


def anchors(
    gaussians: Gaussians,
    sure: NDArray[np.bool_],
    may_fade: NDArray[np.bool_],
    cameras: Sequence[Camera],
    *,
    near: float | None = None,
    threads: int | None = None,
) -> Anchors:
    """Render the `sure` (N,) Gaussians alone from BETWEEN cameras at equal steps along each edge of the minimum
    spanning tree of `cameras`, so that the order of the inputs does not change the viewpoints.

    Pictures in which nothing is covered are left out; `near` and `threads` are those of `render`.
    """
    if not (sure.any() and may_fade.any()):
        return Anchors((), may_fade)
    subset, pictures = gaussians[sure], []
    for camera in views_between([(cameras[i], cameras[j]) for i, j in minimum_spanning_tree(cameras)], BETWEEN):
        image = render(subset, camera, outputs=("alpha",), near=near, threads=threads)
        covered = image.alpha > COVERED
        if covered.any():
            colours = np.clip(image.rgb / np.maximum(image.alpha, COVERED)[..., None], 0, 1).transpose(2, 0, 1)
            pictures.append(FittedView(np.ascontiguousarray(colours), covered, camera, 1.0))
    return Anchors(tuple(pictures), may_fade)
