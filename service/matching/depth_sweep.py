"""Narrow a depth range to where the photographs match: a coarse plane sweep with a left-right consistency check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import pixel_grid
from ..cameras.depth_range import DepthRange
from ..cameras.view_checks import DEPTH_PLANES, MIN_VIEWS, Notice
from ..photographs.images import FittedView
from .coarse_views import CoarseView, coarse_view, nearest_neighbours
from .plain_views import plain_views
from .plane_sweep import best_planes, plane_depths, step_px, swept_px
from .window_match import contrast

F64 = NDArray[np.float64]

COARSE_PX = 7.0  # at 8 narrowing gave 0.3 to 1.7 dB on four of five scenes, at 14 on all of them
CLOSER = 0.8  # of the spacing, or less, or a given range stays: right ones of wide pairs lose as much as they gain
PLANES = 64  # at least
GOOD_MATCH = 0.7  # correlation
AGREEMENT_PX = 1.5  # round trip error, on the coarse grid
MIN_MATCHED = 0.1  # share of the kept pixels; with fewer matches the range stays as it was
PERCENTILE = 0.03  # of the matched contrast, at either end; wrong matches make up a few per cent
BEFORE = 0.6  # near = 0.6 x the 3rd percentile: room for what has no match, such as things at the border
BEYOND = 1.5  # far = 1.5 x the 97th; what lies beyond differs by a fraction of a pixel of parallax


@dataclass(frozen=True, eq=False)
class Matches:
    """The pixels of a coarse view that match its nearest neighbour, consistently in both directions."""

    other: int  # the neighbour
    depth: F64  # (h, w) z-depth of the best plane
    score: F64  # (h, w) its correlation, NOT_SEEN where no plane is seen
    good: NDArray[np.bool_]  # (h * w,) the pixels that match
    contrast: F64  # (h, w) of the windows around the pixels


def narrowed(depths: DepthRange, views: Sequence[FittedView], planes: int = DEPTH_PLANES) -> DepthRange:
    """The range narrowed to 0.6 z_3 .. 1.5 z_97; unchanged where too few pixels match.

    z_p is the depth below which p per cent of the matched pixels lie, weighted by contrast. A pixel is matched if its
    best plane correlates by more than GOOD_MATCH with the nearest neighbour, and that view's best plane leads back to
    within AGREEMENT_PX of the pixel. Masked pixels are not compared.

    A given range stays where the network's `planes` are at most COARSE_PX of parallax apart in it, or narrowing would
    hardly bring them closer. Else its near end is moved in first, and its far end only if they are still too far apart.
    """
    apart = planes_apart_px(depths, views, planes)
    if depths.source == "given" and apart <= COARSE_PX:
        return depths
    coarse = [coarse_view(view) for view in views]
    plain = plain_views(coarse)
    if plain.any() and (~plain).sum() >= MIN_VIEWS:  # else the neighbours of a plain view match nothing
        coarse = [view for view, left_out in zip(coarse, plain, strict=True) if not left_out]
    found, weights, share = depths_of_matches(coarse, depths)
    if share < MIN_MATCHED:
        return depths
    first, last = outer_percentiles(found, weights)
    near, far = max(depths.near, BEFORE * first), min(depths.far, BEYOND * last)
    if depths.source == "estimated":
        return DepthRange(near, far, "estimated")
    closer = DepthRange(near, depths.far, "narrowed")
    if planes_apart_px(closer, views, planes) > COARSE_PX:
        closer = DepthRange(near, far, "narrowed")
    return closer if planes_apart_px(closer, views, planes) <= CLOSER * apart else depths


def outer_percentiles(depths: F64, weights: F64) -> tuple[float, float]:
    """The depths (N,) below and above which PERCENTILE of the `weights` (N,) lies."""
    order = np.argsort(depths)
    reached = np.cumsum(weights[order]) / weights.sum()
    first, last = (depths[order][np.searchsorted(reached, p)] for p in (PERCENTILE, 1.0 - PERCENTILE))
    return float(first), float(last)


def planes_apart_px(depths: DepthRange, views: Sequence[FittedView], planes: int) -> float:
    """Parallax between neighbouring planes of the network, in its pixels."""
    return swept_px([view.camera for view in views], depths) / (planes - 1)


def coarse_notices(given: DepthRange, found: DepthRange, views: Sequence[FittedView], planes: int) -> list[Notice]:
    """The warning about a given range that was narrowed to `found`."""
    if found.source != "narrowed":
        return []
    message = (
        f"between near = {given.near:.4g} and far = {given.far:.4g} the network's {planes} depths stand "
        f"{planes_apart_px(given, views, planes):.3g} px of parallax apart, need some {COARSE_PX:g}: the scene is "
        f"looked for from {found.near:.4g} to {found.far:.4g}, where the photographs match"
    )
    cure = "give near and far closer to the scene, near above all"
    return [{"code": "depth_range_coarse", "field": "near", "message": f"{message} ({cure})"}]


def depths_of_matches(views: Sequence[CoarseView], depths: DepthRange) -> tuple[F64, F64, float]:
    """z-depths (M,) of the matched pixels of all views, their weights (M,), and their share of the pixels kept."""
    found = matches(views, depths)
    matched = np.concatenate([match.depth.ravel()[match.good] for match in found])
    weights = np.concatenate([match.contrast.ravel()[match.good] for match in found])
    return matched, weights, len(matched) / max(1, sum(int(view.kept.sum()) for view in views))


def matches(views: Sequence[CoarseView], depths: DepthRange) -> list[Matches]:
    """The matches of every view with its nearest neighbour."""
    cameras = [view.camera for view in views]
    swept = plane_depths(cameras, depths, PLANES, step_px(cameras, depths))
    neighbours = nearest_neighbours(cameras)
    maps = [best_planes(view, views[j], swept) for view, j in zip(views, neighbours, strict=True)]
    found = []
    for (score, depth), view, j in zip(maps, views, neighbours, strict=True):
        weight = contrast(view.grey, view.kept)
        good = (view.kept & (score > GOOD_MATCH) & (weight > 0)).ravel()
        good &= _leads_back(view, depth, views[j], maps[j][1])
        found.append(Matches(j, depth, score, good, weight))
    return found


def _leads_back(view: CoarseView, depth: F64, other: CoarseView, other_depth: F64) -> NDArray[np.bool_]:
    """(h * w,) pixels whose match in `other` has a depth that leads back to them, within AGREEMENT_PX."""
    pixels = pixel_grid(depth.shape)
    there, z = other.camera.project(view.camera.unproject(pixels, depth.ravel()))
    inside = other.camera.shows(there, z)
    cell = np.where(inside[:, None], there, 0.0).astype(np.intp)
    points = other.camera.unproject(cell.astype(np.float64) + 0.5, other_depth[cell[:, 1], cell[:, 0]])
    back, z = view.camera.project(points)
    close = np.abs(back - pixels).max(axis=1) < AGREEMENT_PX  # NaN behind the camera compares as False
    return inside & close & (z > 0)
