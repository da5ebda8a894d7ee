"""Distances of matches from their epipolar lines, which reveal poses that are wrong by less than a degree.

Whatever its depth, a point projects onto one line in another view. Coarse matches are aligned at full resolution
without constraint; the component of the displacement across the line cannot be explained by depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import pixel_grid
from ..cameras.view_checks import Notice
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
LIKE_NOISE_PX = 0.3  # scale of the robust weight: larger residuals weigh less
# A rotation that moves points across their lines by less, per degree, is regularised away; so is another focal length
# that does, per 1.7 %.
UNSEEN_PX = 0.1
# Median residual in px from which poses are doubted if a turn of one camera, with or without another focal length,
# leaves less than half of it, and from which they are doubted anyway. Right pairs, 113 of six captures and 102 that
# were generated, have up to 0.44 px, one 0.72, of which neither takes half where it is that much.
LEAST_PX, LEFT, MOST_PX = 0.5, 0.5, 1.2
SIDE = 256  # px of the shorter side up to which that is so; from there on they grow with it


@dataclass(frozen=True, eq=False)
class EpipolarResidual:
    """Epipolar residuals of a pair of views."""

    pair: tuple[int, int]
    px: float  # median distance from the epipolar line
    turned_px: float  # the same after the best rotation of the second camera
    turn: float  # rad, angle of that rotation
    zoomed_px: float  # after the best rotation together with the best focal length of the second camera
    zoom: float  # natural logarithm of that focal length's ratio to the given one

    def inexact(self, unit: float) -> bool:
        """Whether cameras are doubted, at `unit` times SIDE."""
        left = min(self.turned_px, self.zoomed_px)
        return self.px > MOST_PX * unit or (self.px > LEAST_PX * unit and left < LEFT * self.px)

    def cause(self, one: int, other: int) -> str:
        """The change of a camera that explains the most, the views being called `one` and `other`."""
        if self.zoomed_px >= LEFT * self.turned_px:
            return f"with one of them turned by {np.degrees(self.turn):.2g} degrees it would be {self.turned_px:.2f} px"
        shorter, longer = (one, other) if self.zoom > 0 else (other, one)
        percent = 100 * np.expm1(abs(self.zoom))
        return (
            f"with the focal length of view {longer} {percent:.2g} % longer, or that of view {shorter} as much "
            f"shorter, it would be {self.zoomed_px:.2f} px"
        )


def inexact_poses(pairs: PairMatches, numbers: Sequence[int]) -> list[Notice]:
    """The warning about the pair of neighbouring views with the largest residual beyond noise, if there is one.

    `numbers` are what the caller calls the views.
    """
    height, width = pairs.views[0].image.shape[1:]
    unit = max(1.0, min(height, width) / SIDE)
    found = [residual for residual in epipolar_residuals(pairs) if residual.inexact(unit)]
    if not found:
        return []
    worst = max(found, key=lambda residual: residual.px)
    one, other = (numbers[view] for view in worst.pair)
    message = (
        f"at {width} x {height} px what views {one} and {other} have in common stands {worst.px:.2f} px (median) "
        f"beside where their cameras allow it, usual is {0.1 * unit:.1f} to {0.5 * unit:.1f}; "
        f"{worst.cause(one, other)}"
    )
    if len(found) > 1:
        others = [
            " and ".join(str(numbers[view]) for view in residual.pair) for residual in found if residual is not worst
        ]
        message += f"; the same of views {', '.join(others)}"
    cure = "are poses and intrinsics exact, and those of these very photographs? refine them, for example with COLMAP"
    return [{"code": "poses_inexact", "field": "cameras", "message": f"{message} ({cure})", "px": round(worst.px, 3)}]


def epipolar_residuals(pairs: PairMatches) -> list[EpipolarResidual]:
    """Per pair of nearest neighbours with ENOUGH matches; distances are in px of the views."""
    pictures = [_picture(view) for view in pairs.views]
    residuals = []
    for pair in pairs.nearest():
        views, drawn = [pairs.views[view] for view in pair], [pictures[view] for view in pair]
        parts = [_residuals(index, match, views, drawn) for index, match in enumerate(pairs.of(*pair))]
        px, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
        if len(px) >= ENOUGH:
            turn, turned = _best_change(px, slopes[:, :3])
            change, zoomed = _best_change(px, slopes)
            given_px, turned_px, zoomed_px = (float(np.median(np.abs(rest))) for rest in (px, turned, zoomed))
            residuals.append(
                EpipolarResidual(pair, given_px, turned_px, float(np.linalg.norm(turn)), zoomed_px, float(change[3]))
            )
    return residuals


def _residuals(index: int, match: Matches, views: Sequence[FittedView], pictures: Sequence[F64]) -> tuple[F64, F64]:
    """(N,) signed distances in px from their epipolar lines, in the other view, of points of view `index` of the pair;
    and (N, 4) their derivatives by a rotation of the pair's second camera about the axes of the world, px per rad, and
    by the logarithm of its focal length."""
    view, other = views[index], views[match.other]
    pixels, depth = _surfaces(match, view, other)
    offsets = pixel_grid((2 * RADIUS + 1,) * 2) - (RADIUS + 0.5)
    window = pixels[:, None] + offsets
    points = view.camera.unproject(window.reshape(-1, 2), np.repeat(depth, len(offsets)))
    there, _ = other.camera.project(points)
    there = there.reshape(window.shape)
    shift, good = _alignment(_sampled(pictures[index], window), pictures[match.other], there)
    good &= _inside(window, pictures[index]) & np.isfinite(there).all(axis=(1, 2))
    points = view.camera.unproject(pixels, depth)
    cam = (points - other.camera.center) @ other.camera.rotation
    rays = (points - view.camera.center) @ other.camera.rotation  # along which a point moves with its depth
    flow = _projection_jacobian(other, cam)
    line = np.einsum("nij,nj->ni", flow, rays)
    length = np.linalg.norm(line, axis=1)
    good &= length > 0
    normal = np.stack([-line[:, 1], line[:, 0]], axis=1) / np.where(length > 0, length, 1.0)[:, None]
    # A turn of the second camera moves what it sees the other way, and what is seen from it along with it; of a longer
    # focal length, what it sees moves away from its axis, and what is seen from it towards the axis.
    second, sign = (other, -1.0) if match.other == 1 else (view, 1.0)
    offset = (points - second.camera.center)[:, None]
    ahead = second.camera.rotation[:, 2]
    away = offset - (offset @ ahead)[..., None] * ahead
    moved = sign * np.concatenate([np.cross(np.eye(3)[None], offset), -away], axis=1)  # (N, 4, 3) in the world
    slopes = -np.einsum("ni,nij,naj->na", normal, flow, moved @ other.camera.rotation)
    return (shift * normal).sum(axis=1)[good], slopes[good]


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


def _projection_jacobian(view: FittedView, points: F64) -> F64:
    """(N, 2, 3) Jacobian of the projection, px per unit, at `points` (N, 3) in the camera's axes."""
    camera, (x, y, z) = view.camera, points.T
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


def _best_change(px: F64, slopes: F64) -> tuple[F64, F64]:
    """(C,) the change of the second camera that best explains the distances `px` (N,) with their derivatives `slopes`
    (N, C), by iteratively reweighted least squares; and (N,) the distances that remain."""
    count = slopes.shape[1]
    change: F64 = np.zeros(count)
    for _ in range(REWEIGHTINGS):
        weights = 1.0 / (1.0 + np.abs(px + slopes @ change) / LIKE_NOISE_PX)
        least = np.linalg.norm(weights) * np.degrees(UNSEEN_PX) * np.eye(count)
        system = np.concatenate([slopes * weights[:, None], least])
        change = np.asarray(np.linalg.lstsq(system, np.append(-px * weights, np.zeros(count)))[0])
    return change, px + slopes @ change


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
