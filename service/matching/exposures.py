"""Exposure differences between photographs: estimated per channel from matches, and corrected to the median exposure.

The network and the stages after it compare colours and take a gain between two photographs for a wrong depth. The
correlation that finds the matches here is invariant to gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.view_checks import Notice
from ..photographs.fitting import FittedPhotos
from ..photographs.images import FittedView, PackedView
from .coarse_views import block_means, block_px, kept_block_means
from .depth_sweep import MIN_MATCHED
from .pair_matches import PairMatches

F64 = NDArray[np.float64]

# Least natural logarithm of a channel's factor, and the share of the matches, at least, in which the same photograph
# has more of it. Other factors are of the surfaces, which shine one way or lie in a shade of their own: of 171 pairs of
# seven captures those beyond 0.08 have shares of up to 0.75, of a phone's pictures up to 0.85, and of a clip whose
# camera adapts by factors of up to 1.8 up to 0.99. Pictures of factors below 1.1 lose as much as they gain.
BEYOND_DOUBT = ((0.08, 0.9), (0.2, 0.8))
CHANNELS = ("red", "green", "blue")
DARK, BRIGHT = 0.05, 0.95  # of white; beyond them noise and clipping hide the factor
# A nearly black photograph has too few pixels above DARK: those above BLACK are compared then. Rounding and noise shift
# such levels, so that only factors above LARGE are believed.
BLACK, LARGE = 2 / 255, 2.0


@dataclass(frozen=True, eq=False)
class Exposures:
    """Gains that bring the views to one exposure."""

    gains: F64  # (V, 3) factors for each view's channels, towards the median exposure
    parts: list[list[int]]  # connected components of the views under comparison; one where all are connected


def equalised(photos: FittedPhotos, pairs: PairMatches, numbers: Sequence[int]) -> tuple[FittedPhotos, list[Notice]]:
    """The photographs corrected to one exposure, and the warning about it; unchanged, without one, where exposures do
    not differ. `pairs` are of `photos.seen`; `numbers` are what the caller calls the views."""
    found = exposures(pairs)
    if found is None:
        return photos, []
    gains = found.gains
    seen = [_exposed(view, gain) for view, gain in zip(photos.seen, gains, strict=True)]
    finer = photos.shown[0] is not photos.seen[0]
    shown = [_exposed(view, gain) for view, gain in zip(photos.shown, gains, strict=True)] if finer else seen
    fine = [_packed(view, gain) for view, gain in zip(photos.fine, gains, strict=True)]
    return replace(photos, seen=seen, shown=shown, fine=fine), [_notice(found, numbers)]


def _notice(found: Exposures, numbers: Sequence[int]) -> Notice:
    """The warning about exposures that differ: it names the channel and the two views of the largest factor."""
    gains = found.gains
    told = ", ".join(f"{number} times {gain.mean():.3g}" for number, gain in zip(numbers, gains, strict=True))
    spread = [np.ptp(np.log(gains[views]), axis=0) for views in found.parts]
    part, channel = np.unravel_index(np.argmax(spread), np.shape(spread))
    light, *_, dark = sorted(found.parts[part], key=lambda view: float(gains[view, channel]))
    factor = gains[light, channel] / gains[dark, channel]
    message = (
        f"where photographs match, view {numbers[dark]} has {factor:.2f} times as much {CHANNELS[channel]} as view "
        f"{numbers[light]}: their colours were brought to one exposure, the middle one ({told})"
    )
    if len(found.parts) > 1:
        apart = "; ".join(", ".join(str(numbers[view]) for view in views) for views in found.parts)
        message += f"; not enough matches to compare these groups of views with each other: {apart}"
    return {
        "code": "exposures_differ",
        "field": "images",
        "index": numbers[dark],
        "message": message,
        "gains": gains.round(4).tolist(),
    }


def exposures(pairs: PairMatches) -> Exposures | None:
    """The gains, or None where no two compared views differ beyond doubt.

    Pairs of views are compared, nearest first, until all are connected. The difference of two log exposures is the
    median of log(one / other) over their coarse matches. The target is the median over the views (of two their
    geometric mean), so that one odd photograph does not change the others.
    """
    views = pairs.views
    colours = [_block_colours(view) for view in views]
    centers = np.stack([view.camera.center for view in views])
    part = list(range(len(views)))
    logs, differ = np.zeros((len(views), 3)), False
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    for one, other in sorted(combinations(part, 2), key=lambda pair: float(apart[pair])):
        if part[one] == part[other]:
            continue
        compared = _compared(pairs, (one, other), colours)
        if compared is None:
            continue
        median, shares = compared
        size, share = np.abs(median), np.maximum(shares.min(axis=0), (1 - shares).min(axis=0))
        differ |= any(bool(((size > least) & (share > agreed)).any()) for least, agreed in BEYOND_DOUBT)
        joined = [view for view in range(len(views)) if part[view] == part[other]]
        logs[joined] += logs[one] - median - logs[other]
        for view in joined:
            part[view] = part[one]
    if not differ:
        return None
    parts = [[view for view in range(len(views)) if part[view] == each] for each in dict.fromkeys(part)]
    for members in parts:
        logs[members] -= np.median(logs[members], axis=0)
    return Exposures(np.exp(-logs), parts)


def _compared(pairs: PairMatches, pair: tuple[int, int], colours: Sequence[F64]) -> tuple[F64, F64] | None:
    """(3,) median of log(first / second) over matches that are neither too dark nor too bright in either view, and
    (2, 3) shares of matches in which the first is brighter: among those, and among those that are too bright in at most
    one view. None where few match.

    The second share corrects a selection bias: where both are overexposed, the few matches that are too bright in
    neither depend on which of the two is darker. If nearly everything is too dark in one view, matches above BLACK
    decide, and only a factor above LARGE counts.
    """
    matched = [(1 - 2 * place, own, theirs) for place, own, theirs in pairs.values(pair, colours)]
    few = MIN_MATCHED * sum(pairs.coarse[view].kept.sum() for view in pair)  # so few match by chance
    compared = _compared_above(DARK, matched, few)
    if compared is not None:
        return compared
    dim = _compared_above(BLACK, matched, few)
    return None if dim is None or np.abs(dim[0]).min() < np.log(LARGE) else dim


def _compared_above(dark: float, matched: Sequence[tuple[int, F64, F64]], few: float) -> tuple[F64, F64] | None:
    """As `_compared`, over matches lighter than `dark` in both views; None for `few` of them or fewer. `matched` holds,
    per direction, its sign (1 for the pair's first view, -1 for the second), the view's colours (M, 3) and the matching
    ones (M, 3) of the other view."""
    ratios, differences = [], []
    for sign, own, theirs in matched:
        least, most = np.minimum(own, theirs), np.maximum(own, theirs)
        lit = (least > dark).all(axis=1)
        usable = lit & (most < BRIGHT).all(axis=1)
        ratios.append(sign * np.log(own[usable] / theirs[usable]))
        differences.append(sign * np.where(least < BRIGHT, own - theirs, 0.0)[lit])
    logs, signs = np.concatenate(ratios), np.sign(np.concatenate(differences))
    if len(logs) <= few:
        return None
    more = np.count_nonzero(signs > 0, axis=0) / np.maximum(np.count_nonzero(signs, axis=0), 1)
    return np.median(logs, axis=0), np.stack([(logs > 0).mean(axis=0), more])


def _block_colours(view: FittedView) -> F64:
    """(h, w, 3) mean colours of the kept pixels of each cell of the coarse view."""
    block = block_px(view)
    share = block_means(view.kept.astype(np.float64), block)
    return np.stack([kept_block_means(channel, view.kept, share, block) for channel in view.image], axis=-1)


def _exposed(view: FittedView, gain: F64) -> FittedView:
    image = view.image * gain.astype(np.float32)[:, None, None]
    return replace(view, image=np.minimum(image, np.float32(1)))


def _packed(view: PackedView, gain: F64) -> PackedView:
    pixels = view.pixels.copy()
    pixels[:, :, :3] = np.minimum(np.rint(pixels[:, :, :3] * gain), 255)
    return replace(view, pixels=pixels)
