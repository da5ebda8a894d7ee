"""Photometric residuals of a scene against target pictures, and the sensitivity of each Gaussian to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from ..photographs.images import FittedView, PackedView
from ..splat import Leverage, Planes, Render, leverage

ROBUST = 0.05  # residual of a channel at which a pixel's weight is halved: exposures, highlights and noise differ too
COVERED = 1e-3  # opacity below which a pixel has no colour to compare


@dataclass(eq=False)
class Targets:
    """Target views, and how much of each the scene covered when it was first compared.

    A pixel with mean absolute residual d over the channels has the weight 1 / (1 + d / ROBUST) (Fair's function of
    robust regression), a masked one 0. The background of a partly covered pixel is the pixel's own mean colour: the
    true one is unknown, and must not make a Gaussian seem too bright. Where coverage was lost since the first
    comparison, the lost part is filled, per channel, with black or white, whichever is farther from the target: opening
    a hole can never reduce a residual.
    """

    views: Sequence[FittedView | PackedView]
    _covered: dict[int, NDArray[np.float32]] = field(default_factory=dict, init=False)  # index -> (H, W) first opacity

    def sums(
        self,
        now: Gaussians,
        near: float | None,
        threads: int | None,
        *,
        share: float = 1.0,
        onto: Leverage | None = None,
    ) -> Leverage:
        """The sums over all views, with weights scaled by `share`, added to `onto` if given. The first call fixes what
        counts as covered. `near` and `threads` are those of `render`."""
        sums = Leverage.of(len(now)) if onto is None else onto
        for number, view in enumerate(self.views):
            judge = partial(self._residual, number, share)
            leverage(now, view.camera, judge, near=near, threads=threads, onto=sums)
        return sums

    def _residual(self, number: int, share: float, image: Render) -> Planes:
        """The picture over its background (H, W, 3), its residual (H, W, 3) against the target, and weights (H, W)."""
        view = self.views[number]
        wanted = view.image.transpose(1, 2, 0)
        weight = np.where(image.alpha > COVERED, np.float32(share), np.float32(0))
        if view.mask is not None:
            weight *= view.mask
        drawn = image.rgb  # changed in place: nothing else holds it
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
