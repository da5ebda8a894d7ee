"""Photographs of one scene that were exposed differently: found by what matches, and brought to the middle one.

The network, the matching of depths and the mending compare colours; a factor between two photographs is to them what a
wrong depth is. Correlation, by which places are matched here, does not see it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.depth_range import DepthRange
from ..cameras.view_checks import Notice
from ..photographs.bilinear import bilinear
from ..photographs.fitting import FittedPhotos
from ..photographs.images import FittedView, PackedView
from .coarse_views import CoarseView, block_means, block_px, coarse_view, pixel_grid
from .depth_sweep import MIN_MATCHED, matches

F64 = NDArray[np.float64]

# Least natural logarithm of a channel's factor, and the share of the matches, at least, in which the same photograph
# has more of it. Other factors are of the surfaces, which shine one way or lie in a shade of their own: of 171 pairs of
# seven captures those beyond 0.08 have shares of up to 0.75, of a phone's pictures up to 0.85, and of a clip whose
# camera adapts by factors of up to 1.8 up to 0.99. Pictures of factors below 1.1 lose as much as they gain.
BEYOND_DOUBT = ((0.08, 0.9), (0.2, 0.8))
CHANNELS = ("red", "green", "blue")
DARK, BRIGHT = 0.05, 0.95  # of white; beyond them noise and clipping hide the factor


@dataclass(frozen=True, eq=False)
class Exposures:
    """How the views were exposed."""

    gains: F64  # (V, 3) by what each view's channels are to be multiplied for all to have the one in the middle
    parts: list[list[int]]  # views that were compared, directly or by way of others; one part where all were


def equalised(photos: FittedPhotos, depths: DepthRange, numbers: Sequence[int]) -> tuple[FittedPhotos, list[Notice]]:
    """The photographs with colours as one exposure would have them, and what to tell; as they are where they have
    that. `numbers` are what the caller calls the views."""
    found = exposures(photos.seen, depths)
    if found is None:
        return photos, []
    gains = found.gains
    seen = [_exposed(view, gain) for view, gain in zip(photos.seen, gains, strict=True)]
    finer = photos.shown[0] is not photos.seen[0]
    shown = [_exposed(view, gain) for view, gain in zip(photos.shown, gains, strict=True)] if finer else seen
    fine = [_packed(view, gain) for view, gain in zip(photos.fine, gains, strict=True)]
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
    notice: Notice = {"code": "exposures_differ", "field": "images", "index": numbers[dark], "message": message}
    return replace(photos, seen=seen, shown=shown, fine=fine), [{**notice, "gains": gains.round(4).tolist()}]


def exposures(views: Sequence[FittedView], depths: DepthRange) -> Exposures | None:
    """None where no two views that are compared differ beyond doubt.

    Pairs of views are compared, the nearest first, until all are joined, each where coarse windows of both match. The
    median over the matches of log(one / other) is the difference of their exposures; the one that all are brought to is
    the median over the views (of two the geometric mean), so that one odd photograph does not change the others.
    """
    coarse, colours = [coarse_view(view) for view in views], [_block_colours(view) for view in views]
    centers = np.stack([view.camera.center for view in views])
    part = list(range(len(views)))
    logs, differ = np.zeros((len(views), 3)), False
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    for one, other in sorted(combinations(part, 2), key=lambda pair: float(apart[pair])):
        if part[one] == part[other]:
            continue
        ratios = _ratios([coarse[one], coarse[other]], [colours[one], colours[other]], depths)
        if ratios is None:
            continue
        median, more = np.median(ratios, axis=0), (ratios > 0).mean(axis=0)
        size, share = np.abs(median), np.maximum(more, 1 - more)
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


def _ratios(pair: Sequence[CoarseView], colours: Sequence[F64], depths: DepthRange) -> F64 | None:
    """(M, 3) log(first / second) of what matches and is neither too dark nor too bright in either; None where that is
    little."""
    found = []
    for index, match in enumerate(matches(pair, depths)):
        view, other = pair[index], pair[match.other]
        pixels, depth = pixel_grid(match.depth.shape)[match.good], match.depth.ravel()[match.good]
        there, _ = other.camera.project(view.camera.unproject(pixels, depth))
        own, theirs = colours[index].reshape(-1, 3)[match.good], bilinear(colours[match.other], *(there - 0.5).T)
        usable = (np.minimum(own, theirs) > DARK).all(axis=1) & (np.maximum(own, theirs) < BRIGHT).all(axis=1)
        found.append((1 - 2 * index) * np.log(own[usable] / theirs[usable]))
    ratios = np.concatenate(found)
    return ratios if len(ratios) > MIN_MATCHED * sum(view.kept.sum() for view in pair) else None  # few are by chance


def _block_colours(view: FittedView) -> F64:
    """(h, w, 3) means over the cells of the coarse view, of what the mask keeps."""
    block = block_px(view)
    share = block_means(view.kept.astype(np.float64), block)
    channels = [block_means(np.where(view.kept, channel, 0.0), block) for channel in view.image]
    return np.stack(channels, axis=-1) / np.where(share > 0, share, 1.0)[..., None]


def _exposed(view: FittedView, gain: F64) -> FittedView:
    image = view.image * gain.astype(np.float32)[:, None, None]
    return replace(view, image=np.minimum(image, np.float32(1)))


def _packed(view: PackedView, gain: F64) -> PackedView:
    pixels = view.pixels.copy()
    pixels[:, :, :3] = np.minimum(np.rint(pixels[:, :, :3] * gain), 255)
    return replace(view, pixels=pixels)
