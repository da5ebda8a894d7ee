"""Pictures that a scene should show, compared with what it shows: what each Gaussian does to the differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from ..photographs.images import FittedView, PackedView
from ..splat import Leverage, Planes, Render, leverage

ROBUST = 0.05  # of a channel: difference at which a pixel counts half; exposures, highlights and noise differ as well
COVERED = 1e-3  # opacity below which a pixel shows no colour that could be right or wrong


@dataclass(eq=False)
class Compared:
    """Views whose pictures the scene should show, and how much of each the scene covered when it was first compared.

    A pixel whose difference has the mean size d over the channels weighs 1 / (1 + d / ROBUST) (Fair's weight of robust
    regression), one that a mask leaves out nothing. Where a pixel is not covered in full, its own mean colour stands
    behind it: no Gaussian is wrong for being brighter than a background that nobody knows. Behind what was covered at
    first and no longer is stands in each channel black or white, whichever is farther from what should be shown: no
    colour that can be shown comes closer by letting the void through.
    """

    views: Sequence[FittedView | PackedView]
    _covered: dict[int, NDArray[np.float32]] = field(default_factory=dict, init=False)  # (H, W) by the view's number

    def sums(
        self,
        now: Gaussians,
        near: float | None,
        threads: int | None,
        *,
        share: float = 1.0,
        onto: Leverage | None = None,
    ) -> Leverage:
        """Over all views, of each pixel `share`, added to `onto` where that is given; the first set that is compared
        tells what was covered. `near` is that of `render`."""
        sums = Leverage.of(len(now)) if onto is None else onto
        for number, view in enumerate(self.views):
            judge = partial(self._judged, number, share)
            leverage(now, view.camera, judge, near=near, threads=threads, onto=sums)
        return sums

    def _judged(self, number: int, share: float, image: Render) -> Planes:
        """What is drawn with what stands behind it (H, W, 3), its difference (H, W, 3), each pixel's weight (H, W)."""
        view = self.views[number]
        wanted = view.image.transpose(1, 2, 0)
        weight = np.where(image.alpha > COVERED, np.float32(share), np.float32(0))
        if view.mask is not None:
            weight *= view.mask
        drawn = image.rgb  # nobody else's
        drawn /= np.maximum(image.alpha, np.float32(COVERED))[..., None]
        lost = np.maximum(self._covered.setdefault(number, image.alpha) - image.alpha, 0)[..., None]
        difference = np.subtract(wanted < 0.5, drawn, dtype=np.float32)
        difference *= lost
        drawn += difference
        np.clip(drawn, 0, 1, out=difference)
        difference -= wanted
        del wanted  # a packed view's takes memory of its own
        weight /= 1 + np.abs(difference).mean(axis=2) / np.float32(ROBUST)
        return drawn, difference, weight
