"""Narrow a depth range to where the photographs match: a coarse plane sweep, checked in both directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.depth_range import DepthRange
from ..cameras.view_checks import DEPTH_PLANES, Notice
from ..photographs.images import FittedView
from .coarse_views import CoarseView, coarse_view, nearest_neighbours, pixel_grid
from .plane_sweep import best_planes, planes, step_px, swept_px
from .window_match import contrast

F64 = NDArray[np.float64]

COARSE_PX = 7.0  # at 8 narrowing gave 0.3 to 1.7 dB on four of five scenes, at 14 on all of them
CLOSER = 0.8  # as close or closer, or a given range stays: right ones of wide pairs lose as much as they gain
PLANES = 64  # at least
GOOD_MATCH = 0.7  # correlation
AGREEMENT_PX = 1.5  # there and back again, on the coarse grid
MIN_MATCHED = 0.1  # share of the pixels kept; with fewer the range stays as it was
PERCENTILE = 0.03  # of the matched contrast, at either end; wrong matches make up a few per cent
BEFORE = 0.6  # near = 0.6 x the 3rd percentile: room for what has no match, such as things at the border
BEYOND = 1.5  # far = 1.5 x the 97th; what lies beyond differs by a fraction of a pixel of parallax


@dataclass(frozen=True, eq=False)
class Matches:
    """What of a view matches its nearest neighbour, there and back again."""

    other: int  # the neighbour
    depth: F64  # (h, w) z-depth of the best plane
    good: NDArray[np.bool_]  # (h * w,) the pixels that match
    contrast: F64  # (h, w) of the windows about them


def narrowed(depths: DepthRange, views: Sequence[FittedView], planes: int = DEPTH_PLANES) -> DepthRange:
    """A range narrowed to 0.6 z_3 .. 1.5 z_97; one without enough matches as it is.

    So is a given one in which the network's `planes` stand up to COARSE_PX of parallax apart, or would be hardly
    closer. Else its near end is drawn in, and its far end only where they would still stand farther apart.

    z_p are the depths below which p per cent of the matched pixels lie, weighted by contrast; a pixel is matched if its
    best plane correlates by 0.7 with the nearest other view, and that view's best plane leads back to within 1.5 px.
    What masks leave out is compared with nothing.
    """
    apart = planes_apart_px(depths, views, planes)
    if depths.source == "given" and apart <= COARSE_PX:
        return depths
    found, weights, share = matched_depths([coarse_view(view) for view in views], depths)
    if share < MIN_MATCHED:
        return depths
    order = np.argsort(found)
    reached = np.cumsum(weights[order]) / weights.sum()
    first, last = (found[order][np.searchsorted(reached, p)] for p in (PERCENTILE, 1.0 - PERCENTILE))
    near, far = max(depths.near, BEFORE * float(first)), min(depths.far, BEYOND * float(last))
    if depths.source == "estimated":
        return DepthRange(near, far, "estimated")
    closer = DepthRange(near, depths.far, "narrowed")
    if planes_apart_px(closer, views, planes) > COARSE_PX:
        closer = DepthRange(near, far, "narrowed")
    return closer if planes_apart_px(closer, views, planes) <= CLOSER * apart else depths


def planes_apart_px(depths: DepthRange, views: Sequence[FittedView], planes: int) -> float:
    """The parallax from one of the network's planes to the next, in its pixels."""
    return swept_px([view.camera for view in views], depths) / (planes - 1)


def coarse_notices(given: DepthRange, found: DepthRange, views: Sequence[FittedView], planes: int) -> list[Notice]:
    """The warning about a given range that was narrowed to `found`."""
    if found.source != "narrowed":
        return []
    message = (
        f"between the given near = {given.near:.4g} and far = {given.far:.4g} the network's {planes} depths stand "
        f"{planes_apart_px(given, views, planes):.3g} px of parallax apart, need some {COARSE_PX:g}: the scene is "
        f"looked for from {found.near:.4g} to {found.far:.4g}, where the photographs match"
    )
    cure = "give near and far closer about the scene, near above all, or neither"
    return [{"code": "depth_range_coarse", "field": "near", "message": f"{message} ({cure})"}]


def matched_depths(views: Sequence[CoarseView], depths: DepthRange) -> tuple[F64, F64, float]:
    """z-depths (M,) of the matched pixels of all views, their weights (M,), and their share of the pixels kept."""
    found = matches(views, depths)
    matched = np.concatenate([match.depth.ravel()[match.good] for match in found])
    weights = np.concatenate([match.contrast.ravel()[match.good] for match in found])
    return matched, weights, len(matched) / max(1, sum(int(view.kept.sum()) for view in views))


def matches(views: Sequence[CoarseView], depths: DepthRange) -> list[Matches]:
    """Of every view with its nearest neighbour."""
    cameras = [view.camera for view in views]
    swept = planes(cameras, depths, PLANES, step_px(cameras, depths))
    neighbours = nearest_neighbours(cameras)
    maps = [best_planes(view, views[j], swept) for view, j in zip(views, neighbours, strict=True)]
    found = []
    for (score, depth), view, j in zip(maps, views, neighbours, strict=True):
        weight = contrast(view.grey, view.kept)
        good = (view.kept & (score > GOOD_MATCH) & (weight > 0)).ravel()
        good &= _leads_back(view, depth, views[j], maps[j][1])
        found.append(Matches(j, depth, good, weight))
    return found


def _leads_back(view: CoarseView, depth: F64, other: CoarseView, other_depth: F64) -> NDArray[np.bool_]:
    """Per pixel whether the pixel of `other` that its depth leads to has a depth that leads back."""
    pixels = pixel_grid(depth.shape)
    there, z = other.camera.project(view.camera.unproject(pixels, depth.ravel()))
    height, width = other_depth.shape
    inside = (z > 0) & ((there >= 0) & (there < (width, height))).all(axis=1)
    cell = np.where(inside[:, None], there, 0.0).astype(np.intp)
    points = other.camera.unproject(cell.astype(np.float64) + 0.5, other_depth[cell[:, 1], cell[:, 0]])
    back, z = view.camera.project(points)
    close = np.abs(back - pixels).max(axis=1) < AGREEMENT_PX  # NaN behind the camera compares as False
    return inside & close & (z > 0)
