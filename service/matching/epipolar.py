"""Distances of matches from their epipolar lines, which reveal poses that are wrong by less than a degree.

Whatever its depth, a point projects onto one line in another view. Coarse matches are aligned at full resolution
without constraint; the component of the displacement across the line cannot be explained by depth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera, pixel_grid
from ..cameras.depth_range import longest_between
from ..photographs.bilinear import bilinear
from ..photographs.images import FittedView
from .coarse_views import block_px
from .correspondence import KEPT
from .depth_sweep import Matches
from .pair_matches import PairMatches

F64 = NDArray[np.float64]

RADIUS = 5  # windows of 11 x 11 px
POINTS = 200  # of each view, at most
ENOUGH = 40  # of a pair
STEPS = 6  # of the alignment
REWEIGHTINGS = 12  # of the least squares
FARTHEST_PX = 6.0  # largest shift from the coarse match, and largest disparity between its neighbours' depths
GOOD_MATCH = 0.9  # correlation, once aligned
CORNER = 0.05  # least ratio of the structure tensor's eigenvalues: a window with a mere edge slides along it
NO_LINE_PX = 1e-6  # by which a point moves while its depth grows e-fold: mere rounding, of cameras in one place
LIKE_NOISE_PX = 0.3  # scale of the robust weight: larger residuals weigh less
TURN, ZOOM, SHIFT = slice(0, 3), 3, slice(4, 7)  # of the changes of a camera
CHANGES = 7
# A change that moves points across their lines by less, per rad, e times the focal length, or longest baseline, is
# regularised away: 0.1 px per degree, 1.7 % of a focal length or 7 % of a baseline. With four times as much for the
# last, seven generated scenes with a wrong position were 1.1 dB worse, and those with a wrong turn the same.
UNSEEN_PX = np.repeat([5.7, 5.7, 1.4], [3, 1, 3])


@dataclass(frozen=True, eq=False)
class EpipolarDistances:
    """N matches of a pair of views, with their distances from their epipolar lines."""

    pair: tuple[int, int]
    px: F64  # (N,) signed
    # (N, 2, CHANGES) their derivatives by changes of both cameras of the pair: rotations about the axes of the world,
    # px per rad, the logarithm of the focal length, and shifts along the axes of the world in `longest_baseline`s
    slopes: F64


def epipolar_distances(pairs: PairMatches, chosen: Iterable[tuple[int, int]]) -> list[EpipolarDistances]:
    """Per `chosen` pair of views with ENOUGH matches; in px of the views."""
    pictures, unit = [_picture(view) for view in pairs.views], longest_baseline(pairs.views)
    found = []
    for pair in chosen:
        views, drawn = [pairs.views[view] for view in pair], [pictures[view] for view in pair]
        parts = [_distances(index, match, views, drawn, unit) for index, match in enumerate(pairs.of(*pair))]
        px, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
        if len(px) >= ENOUGH:
            found.append(EpipolarDistances(pair, px, slopes))
    return found


def best_change(px: F64, slopes: F64, unseen: F64) -> tuple[F64, F64]:
    """(C,) the change that best explains the distances `px` (N,) with their derivatives `slopes` (N, C), regularised by
    those `unseen` (C,) in px, by iteratively reweighted least squares; and (N,) the distances that remain."""
    count = slopes.shape[1]
    change: F64 = np.zeros(count)
    for _ in range(REWEIGHTINGS):
        weights = 1.0 / (1.0 + np.abs(px + slopes @ change) / LIKE_NOISE_PX)
        least = np.linalg.norm(weights) * np.diag(unseen)
        system = np.concatenate([slopes * weights[:, None], least])
        change = np.asarray(np.linalg.lstsq(system, np.append(-px * weights, np.zeros(count)))[0])
    return change, px + slopes @ change


def longest_baseline(views: Sequence[FittedView]) -> float:
    """The unit of SHIFT: the largest distance of two cameras."""
    return float(np.linalg.norm(longest_between([view.camera for view in views])))


def _distances(
    index: int, match: Matches, views: Sequence[FittedView], pictures: Sequence[F64], unit: float
) -> tuple[F64, F64]:
    """`EpipolarDistances.px` and `slopes` of points of view `index` of the pair, in the other view."""
    view, other = views[index], views[match.other]
    pixels, depth = _surfaces(match, view, other)
    offsets = pixel_grid((2 * RADIUS + 1,) * 2) - (RADIUS + 0.5)
    window = pixels[:, None] + offsets
    points = view.camera.unproject(window.reshape(-1, 2), np.repeat(depth, len(offsets)))
    there, _ = other.camera.project(points)
    there = there.reshape(window.shape)
    shift, good = _alignment(_sampled(pictures[index], window), pictures[match.other], there)
    good &= _inside(window, pictures[index]) & np.isfinite(there).all(axis=(1, 2))
    normals, slopes = lines_across(view.camera, other.camera, pixels, depth, unit)
    good &= normals.any(axis=1)
    slopes = slopes if index == 0 else slopes[:, ::-1]
    return (shift * normals).sum(axis=1)[good], slopes[good]


def lines_across(view: Camera, other: Camera, pixels: F64, depth: F64, unit: float) -> tuple[F64, F64]:
    """(N, 2) unit normals, in `other`, of the epipolar lines of `pixels` (N, 2) of `view`, 0 where there is no line;
    and (N, 2, CHANGES) how fast what was matched moves along the normals from the point at z-depth `depth` (N,), by
    changes of `view` and of `other`, as in `EpipolarDistances.slopes`."""
    points = view.unproject(pixels, depth)
    flow = _projection_jacobian(other, (points - other.center) @ other.rotation)
    line = np.einsum("nij,nj->ni", flow, (points - view.center) @ other.rotation)  # a point moves with its depth
    length = np.linalg.norm(line, axis=1, keepdims=True)
    known = length > NO_LINE_PX
    normals = np.where(known, np.stack([-line[:, 1], line[:, 0]], axis=1), 0.0) / np.where(known, length, 1.0)
    # A turn of a camera moves what it sees the other way, and what is seen from it along with it; of a longer focal
    # length, what it sees moves away from its axis, and what is seen from it towards the axis.
    moved = [sign * _moved(points, camera, unit) for camera, sign in ((view, 1.0), (other, -1.0))]
    slopes = [-np.einsum("ni,nij,naj->na", normals, flow, each @ other.rotation) for each in moved]
    return normals, np.stack(slopes, axis=1)


def _moved(points: F64, camera: Camera, unit: float) -> F64:
    """(N, CHANGES, 3) derivatives, in the world, of `points` (N, 3) that a camera carries along: by its rotation about
    the axes of the world, by the logarithm of its focal length at fixed pixels and depths, and by its shift."""
    offset = (points - camera.center)[:, None]
    ahead = camera.rotation[:, 2]
    across = offset - (offset @ ahead)[..., None] * ahead
    shifts = np.broadcast_to(unit * np.eye(3), (len(points), 3, 3))
    return np.concatenate([np.cross(np.eye(3)[None], offset), -across, shifts], axis=1)


def _surfaces(match: Matches, view: FittedView, other: FittedView) -> tuple[F64, F64]:
    """(N, 2) pixels and (N,) z-depths of matched cells whose eight neighbours match as well, at about the same depth:
    windows across a silhouette would follow it, whatever moves behind it. At most POINTS, spread over the picture."""
    rows, columns = match.depth.shape
    cells = np.lib.stride_tricks.sliding_window_view(match.good.reshape(rows, columns), (3, 3)).all(axis=(2, 3))
    about = np.lib.stride_tricks.sliding_window_view(match.depth, (3, 3))
    inside = pixel_grid((rows, columns)).reshape(rows, columns, 2)[1:-1, 1:-1][cells] * block_px(view)
    nearest, farthest = (end(axis=(2, 3))[cells] for end in (about.min, about.max))
    (here, _), (there, _) = (other.camera.project(view.camera.unproject(inside, z)) for z in (nearest, farthest))
    flat = np.flatnonzero(np.linalg.norm(there - here, axis=1) < FARTHEST_PX)
    chosen = flat[:: max(1, -(-len(flat) // POINTS))]
    return inside[chosen], match.depth[1:-1, 1:-1][cells][chosen]


def _projection_jacobian(camera: Camera, points: F64) -> F64:
    """(N, 2, 3) Jacobian of the projection, px per unit, at `points` (N, 3) in the camera's axes."""
    x, y, z = points.T
    flow = np.zeros((len(points), 2, 3))
    flow[:, 0, 0], flow[:, 1, 1] = camera.fx / z, camera.fy / z
    flow[:, 0, 2], flow[:, 1, 2] = -camera.fx * x / z**2, -camera.fy * y / z**2
    return flow


def _alignment(window: F64, picture: F64, there: F64) -> tuple[F64, NDArray[np.bool_]]:
    """(N, 2) shift in px of the positions `there` (N, K, 2) that aligns `picture` (H, W, 4) with `window` (N, K, 4), up
    to gain and offset (Lucas and Kanade, 1981); and (N,) whether the aligned windows match."""
    template, kept = _normalised(window[..., 0])[0], (window[..., 3] > KEPT).all(axis=1)
    places = np.nan_to_num(there, nan=-1e9)
    shift = np.zeros((len(there), 2))
    for step in range(STEPS + 1):
        values = _sampled(picture, places + shift[:, None])
        seen, size = _normalised(values[..., 0])
        if step == STEPS:
            break
        slopes = (values[..., 1:3] - values[..., 1:3].mean(axis=1, keepdims=True)) / size[..., None]
        system = np.einsum("nki,nkj->nij", slopes, slopes)
        least, most = np.linalg.eigvalsh(system).T
        solvable = least > CORNER * most
        system[~solvable] = np.eye(2)
        change = np.linalg.solve(system, np.einsum("nki,nk->ni", slopes, template - seen)[..., None])[..., 0]
        shift += np.where(solvable[:, None], np.clip(change, -1.0, 1.0), 0.0)
    good = kept & (values[..., 3] > KEPT).all(axis=1) & ((template * seen).sum(axis=1) > GOOD_MATCH) & solvable
    return shift, good & (np.abs(shift).max(axis=1) < FARTHEST_PX) & _inside(places + shift[:, None], picture)


def _normalised(values: F64) -> tuple[F64, F64]:
    """(N, K) `values` with zero mean and unit norm per row, and (N, 1) the norms before."""
    values = values - values.mean(axis=1, keepdims=True)
    size = np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-9)
    return values / size, size


def _picture(view: FittedView) -> F64:
    """(H, W, 4) grey, its gradients per px to the right and down, and 1 where the mask keeps the pixel."""
    down, right = np.gradient(view.grey)
    return np.stack([view.grey, right, down, view.kept.astype(np.float64)], axis=-1)


def _sampled(picture: F64, places: F64) -> F64:
    """(N, K, C) bilinear samples of `picture` (H, W, C) at pixel positions (N, K, 2)."""
    return bilinear(picture, places[..., 0] - 0.5, places[..., 1] - 0.5)


def _inside(places: F64, picture: F64) -> NDArray[np.bool_]:
    """(N,) whether all of the places (N, K, 2) lie in the picture."""
    height, width = picture.shape[:2]
    return np.asarray(((places >= 0) & (places <= (width, height))).all(axis=(1, 2)))
