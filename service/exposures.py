"""Photographs of one scene that were exposed differently: found by what matches, and brought to their common mean.

The network, the matching of depths and the mending compare colours; a factor between two photographs is to them what a
wrong depth is. Correlation, by which places are matched here, does not see it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .bilinear import bilinear
from .coarse_views import block_means, block_px, coarse_view, pixel_grid
from .depth_range import DepthRange
from .depth_sweep import MIN_MATCHED, matches
from .fitting import FittedPhotos
from .images import FittedView, PackedView
from .view_checks import Notice

F64 = NDArray[np.float64]

# Least natural logarithm of a channel's factor, and the share of the matches, at least, in which the same photograph
# has more of it. Other factors are of the surfaces, which shine one way or lie in a shade of their own: of 171 pairs of
# seven captures those beyond 0.08 have shares of up to 0.75, of a phone's pictures up to 0.85, and of a clip whose
# camera adapts by factors of up to 1.8 up to 0.99. Pictures of factors below 1.1 lose as much as they gain.
BEYOND_DOUBT = ((0.08, 0.9), (0.2, 0.8))
DARK, BRIGHT = 0.05, 0.95  # of white; beyond them noise and clipping hide the factor


def equalised(photos: FittedPhotos, depths: DepthRange, numbers: Sequence[int]) -> tuple[FittedPhotos, list[Notice]]:
    """The photographs with colours as one exposure would have them, the geometric mean of all, and what to tell; as
    they are where they have that. `numbers` are what the caller calls the views."""
    gains = exposure_gains(photos.seen, depths)
    if gains is None:
        return photos, []
    seen = [_exposed(view, gain) for view, gain in zip(photos.seen, gains, strict=True)]
    finer = photos.shown[0] is not photos.seen[0]
    shown = [_exposed(view, gain) for view, gain in zip(photos.shown, gains, strict=True)] if finer else seen
    fine = [_packed(view, gain) for view, gain in zip(photos.fine, gains, strict=True)]
    told = ", ".join(f"{number} times {gain.mean():.3g}" for number, gain in zip(numbers, gains, strict=True))
    brightness = 1 / gains.mean(axis=1)
    dark, light = int(brightness.argmin()), int(brightness.argmax())
    message = (
        f"where photographs match, view {numbers[dark]} is {brightness[dark] / brightness[light]:.2f} times as bright "
        f"as view {numbers[light]}: the colours of all were brought to their mean ({told})"
    )
    notice: Notice = {"code": "exposures_differ", "field": "images", "index": numbers[dark], "message": message}
    return replace(photos, seen=seen, shown=shown, fine=fine), [{**notice, "gains": gains.round(4).tolist()}]


def exposure_gains(views: Sequence[FittedView], depths: DepthRange) -> F64 | None:
    """(V, 3) by what each view's channels are to be multiplied for all to have one exposure, whose product over the
    views is 1; None where no two views that are compared differ in it beyond doubt.

    Each view is compared with its nearest neighbour where coarse windows of both match. With m the median over the
    matches of log(neighbour / view), the logarithms x of the gains solve x_view - x_neighbour = m by least squares,
    weighted by the matches, and are the shortest that do.
    """
    rows, medians, differ = [], [], False
    for view, other, ratios in _ratios(views, depths):
        median = np.median(ratios, axis=0)
        more = (ratios > 0).mean(axis=0)
        found = np.abs(median), np.maximum(more, 1 - more)
        differ |= any(bool(((found[0] > least) & (found[1] > share)).any()) for least, share in BEYOND_DOUBT)
        row, weight = np.zeros(len(views)), np.sqrt(len(ratios))
        row[view], row[other] = weight, -weight
        rows.append(row)
        medians.append(weight * median)
    if not differ:
        return None
    shortest = np.linalg.lstsq(np.array(rows), np.array(medians), rcond=None)[0]
    return np.exp(shortest)


def _ratios(views: Sequence[FittedView], depths: DepthRange) -> Iterator[tuple[int, int, F64]]:
    """A view, its nearest neighbour, and (M, 3) log(neighbour / view) of what matches and is neither too dark nor too
    bright in either; of every view of which enough is."""
    coarse = [coarse_view(view) for view in views]
    colours = [_block_colours(view) for view in views]
    for index, match in enumerate(matches(coarse, depths)):
        view, other = coarse[index], coarse[match.other]
        pixels, depth = pixel_grid(match.depth.shape)[match.good], match.depth.ravel()[match.good]
        there, _ = other.camera.project(view.camera.unproject(pixels, depth))
        own, theirs = colours[index].reshape(-1, 3)[match.good], bilinear(colours[match.other], *(there - 0.5).T)
        usable = (np.minimum(own, theirs) > DARK).all(axis=1) & (np.maximum(own, theirs) < BRIGHT).all(axis=1)
        if usable.sum() > MIN_MATCHED * view.kept.sum():  # a few match by chance
            yield index, match.other, np.log(theirs[usable] / own[usable])


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
