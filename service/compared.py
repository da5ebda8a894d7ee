"""Pictures that a scene should show, compared with what it shows: what each Gaussian does to the differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .gaussians import Gaussians
from .images import FittedView
from .splat import Leverage, Planes, Render, leverage

ROBUST = 0.05  # of a channel: difference at which a pixel counts half; exposures, highlights and noise differ as well
COVERED = 1e-3  # opacity below which a pixel shows no colour that could be right or wrong


@dataclass(eq=False)
class Compared:
    """Pictures that the scene should show, and how much of each it covered when it was first compared.

    A pixel whose difference has the mean size d over the channels weighs 1 / (1 + d / ROBUST) (Fair's weight of robust
    regression), one that a mask leaves out nothing. Where a pixel is not covered in full, its own mean colour stands
    behind it: no Gaussian is wrong for being brighter than a background that nobody knows. Behind what was covered at
    first and no longer is stands what the picture shows least, black or white: letting the void through brings nothing
    closer.
    """

    views: Sequence[FittedView]
    covered: list[NDArray[np.float32]] = field(default_factory=list)

    def sums(self, now: Gaussians, near: float | None, threads: int | None) -> Leverage:
        """What each Gaussian does to the differences of all of them."""
        sums = Leverage.of(len(now))
        for number, view in enumerate(self.views):

            def judged(image: Render, number: int = number, view: FittedView = view) -> Planes:
                if number == len(self.covered):
                    self.covered.append(image.alpha)
                return _judged(image, view, self.covered[number])

            leverage(now, view.camera, judged, near=near, threads=threads, onto=sums)
        return sums


def _judged(image: Render, view: FittedView, covered: NDArray[np.float32]) -> Planes:
    """The picture (H, W, 3) with what stands behind it, its difference, and each pixel's weight (H, W)."""
    photograph = view.image.transpose(1, 2, 0)
    weight = (image.alpha > COVERED).astype(np.float32)
    if view.mask is not None:
        weight *= view.mask
    picture = image.rgb / np.maximum(image.alpha, np.float32(COVERED))[..., None]
    lost = np.maximum(covered - image.alpha, 0)[..., None]
    picture += lost * ((photograph < 0.5) - picture)
    residual = np.clip(picture, 0, 1) - photograph
    weight /= 1 + np.abs(residual).mean(axis=2) / np.float32(ROBUST)
    return picture, residual, weight
