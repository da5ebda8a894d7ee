"""Photographs with less fine detail than others have of the same surfaces: blurred, out of focus, or enlarged.

Where photographs match, each one's sharpness is the ratio of contrast in a fine and in a coarse frequency band. Gain,
tone curve and shading change both bands alike; blur reduces the fine one first. Blur that leaves nothing of either is
found in bands that are COARSER times as wide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from ..photographs.images import FittedView
from .coarse_views import block_means, block_px
from .pair_matches import PairMatches
from .window_match import window_mean

F64 = NDArray[np.float64]

FINE, COARSE = 1, 4  # px, radii of box filters: the residual of the first is the fine band, their difference the coarse
COARSER = 4  # times FINE and COARSE
CALM = 0.05  # quantile of the matching cells whose power is taken for noise
CONTRAST = 0.01  # of white: least contrast of the coarse band in both views
LEAST_FINE = 1e-3  # of white, added to the fine contrast: smaller ones do not differ
ENOUGH = 40  # matches of a pair
# Median of the logarithm of one photograph's sharpness over the other's, and the share of the matches in which it is
# the sharper. Right pairs, 113 of six captures, have 0.11 and 0.72 at most; with one photograph under a gamma of 0.6,
# or with noise of 10 levels, 0.18 and 0.82, as a JPEG of quality 20 0.25; blurred by a Gaussian of 0.7 px 0.36 and
# more, of 1 px 0.58.
LESS, AGREED = 0.38, 0.85


def less_sharp(pairs: PairMatches, numbers: Sequence[int]) -> list[Notice]:
    """A warning about each view that is clearly less sharp than one of its nearest neighbours, where the two match.

    `numbers` are what the caller calls the views.
    """
    notices: list[Notice] = []
    for view, (log, other) in sorted(views_less_sharp(pairs).items()):
        detail = round(float(np.exp(-log)), 3)
        message = (
            f"where photographs match, view {numbers[view]} has {detail:.0%} of the fine detail of view "
            f"{numbers[other]}: it is blurred by motion or focus, or enlarged, and so is what it adds to the scene"
        )
        cure = "a sharper photograph from there gives a better scene, leaving this one out mostly a worse one"
        where: Notice = {"field": "images", "index": numbers[view], "detail": detail}
        notices.append({"code": "view_less_sharp", "message": f"{message} ({cure})", **where})
    return notices


def views_less_sharp(pairs: PairMatches) -> dict[int, tuple[float, int]]:
    """The views that `less_sharp` names, with the logarithm of how much sharper another one is, and that one."""
    worst: dict[int, tuple[float, int]] = {}
    bands = [_bands(view) for view in pairs.views]
    for pair in pairs.nearest():
        logs = _sharper(pairs, pair, bands)
        if len(logs) < ENOUGH:
            wide = {place: _bands(pairs.views[place], COARSER) for place in pair}
            logs = _sharper(pairs, pair, [wide.get(place, other) for place, other in enumerate(bands)])
        if len(logs) < ENOUGH:
            continue
        median = float(np.median(logs))
        if abs(median) <= LESS or (np.sign(logs) == np.sign(median)).mean() <= AGREED:
            continue
        view, other = pair if median < 0 else pair[::-1]
        worst[view] = max(worst.get(view, (0.0, 0)), (abs(median), other))
    return worst


def _sharper(pairs: PairMatches, pair: tuple[int, int], bands: Sequence[F64]) -> F64:
    """(N,) log ratio of the first view's sharpness to the second's, at matches with contrast in both."""
    logs: list[F64] = []
    for place, own, theirs in pairs.values(pair, bands):
        whole = np.isfinite(own + theirs).all(axis=1)
        if not whole.any():
            continue
        (fine, coarse), (their_fine, their_coarse) = (_contrast(power[whole]).T for power in (own, theirs))
        usable = np.minimum(coarse, their_coarse) > CONTRAST
        ratio = (fine + LEAST_FINE) * their_coarse, (their_fine + LEAST_FINE) * coarse
        logs.append((1 - 2 * place) * np.log(ratio[0][usable] / ratio[1][usable]))
    return np.concatenate(logs) if logs else np.empty(0)


def _contrast(power: F64) -> F64:
    """(N, 2) contrast of bands with `power` (N, 2), less the noise: the CALM quantile over these cells. They show the
    same surfaces in both views; cells that only one view sees, such as a calm wall, would lower its noise alone."""
    return np.sqrt(np.maximum(power - np.quantile(power, CALM, axis=0), 0.0))


def _bands(view: FittedView, times: int = 1) -> F64:
    """(h, w, 2) mean power of the fine and the coarse band, so many `times` as wide, around each cell of the coarse
    view; NaN where any pixel that contributes is masked."""
    grey = view.grey
    fine, coarse = (window_mean(grey, times * radius) for radius in (FINE, COARSE))
    block = block_px(view)
    whole = window_mean(block_means(window_mean(view.kept.astype(np.float64), times * COARSE), block), 1) > 1 - 1e-9
    power = [window_mean(block_means(band**2, block), 1) for band in (grey - fine, fine - coarse)]
    return np.where(whole[..., None], np.stack(power, axis=-1), np.nan)
