"""Pictures that new views should show at least: what two views confirm, seen from cameras between the inputs.

A Gaussian of a dark or plain surface matches the photographs at many depths, and one that only one photograph shows at
all of them. Too near it contradicts no input, but from between them it hides what two of them have confirmed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.shortest_ways import shortest_ways
from ..gaussians import Gaussians
from ..leaving_out.certified import views_between
from ..photographs.images import FittedView
from ..splat import render

BETWEEN = 2  # cameras between two inputs that are neighbours
COVERED = 0.9  # opacity from which a pixel's colour is taken for what should be seen there


@dataclass(frozen=True, eq=False)
class Anchors:
    """Pictures of what is sure, and which Gaussians must not hide it."""

    pictures: tuple[FittedView, ...]  # each with the mask of where it shows anything
    may_fade: NDArray[np.bool_]  # (N,)


def anchors(
    gaussians: Gaussians,
    sure: NDArray[np.bool_],
    may_fade: NDArray[np.bool_],
    cameras: Sequence[Camera],
    *,
    near: float | None = None,
    threads: int | None = None,
) -> Anchors:
    """Draw the `sure` (N,) Gaussians alone from BETWEEN cameras at equal steps on each of the shortest ways that join
    all `cameras`, so that in whatever order the inputs come the pictures are from the same places.

    Pictures in which nothing is covered are left out; `near` and `threads` are those of `render`.
    """
    subset = gaussians[np.flatnonzero(sure)]
    pictures = []
    for camera in views_between(shortest_ways(cameras), BETWEEN) if sure.any() and may_fade.any() else ():
        image = render(subset, camera, outputs=("alpha",), near=near, threads=threads)
        covered = image.alpha > COVERED
        if covered.any():
            colours = np.clip(image.rgb / np.maximum(image.alpha, COVERED)[..., None], 0, 1).transpose(2, 0, 1)
            pictures.append(FittedView(np.ascontiguousarray(colours), covered, camera, 1.0))
    return Anchors(tuple(pictures), may_fade)
