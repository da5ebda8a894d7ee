"""Choosing views of a capture for the network: with large overlap and sufficient parallax."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera, pixel_grid

F64 = NDArray[np.float64]

MAX_SCORED = 400  # views that are compared, evenly spaced in the file: cost is quadratic
GRID = 5  # rays per side of a view, for its overlap with another
SMALL_ANGLE = np.radians(5.0)  # parallax below it makes depth uncertain in proportion
LARGE_ANGLE = np.radians(25.0)  # parallax above it: views differ in appearance and occlusion
NEAR_ANGLE = np.radians(10.0)  # up to which a view covers another well
MIN_TURN = np.radians(2.0)  # between optical axes; below it their intersection is ill-conditioned
MAX_MISS = 0.1  # times the depth: axes with a larger distance do not look at the same point
MIN_REACH = 0.1  # times the baseline: axes that meet closer to a camera than this meet at the camera itself
BEFORE = 0.7  # times the depth where axes meet, since scenes begin in front of their centre
PARALLEL_DEPTH = 4.0  # baselines, if no axes meet: mean inverse depth of what two parallel views share


@dataclass(frozen=True)
class Choice:
    """Ascending indices of the chosen views, and the figures of the choice as JSON values."""

    places: tuple[int, ...]
    said: dict[str, Any]


def chosen_views(cameras: Sequence[Camera], count: int, middles: Sequence[float | None]) -> Choice:
    """Choose `count` of two cameras or more, or all if there are not more; deterministic.

    `middles`: the z-depth of each view at which it is compared, 2 / (1 / near + 1 / far), caller's units; None where
    it is unknown (`compared_depths`).

    With o_ij the share of view i that view j sees at the depth of view i, mean of both directions, and a_ij the angle
    between the two cameras as seen from there, a pair has the quality q_ij = o_ij min(1, a_ij / 5 deg, 25 deg / a_ij),
    one view covers another by c_ij = o_ij min(1, 10 deg / a_ij), and a set has the score

        mean over its views of the largest q with another of it x mean over all views of the largest c with one of it.

    The pair with the highest score comes first, then one view after the other that keeps it highest; ties go to the
    earlier views.

    Of all pairs of five captures of 8 to 12 photographs, reconstructed and compared with the others, the chosen one
    loses 0.4 dB to the best with near and far and 0.9 dB without, the median pair 1.9 dB. The constants were set with
    four of them.
    """
    looked = evenly(len(cameras), MAX_SCORED)
    some = [cameras[place] for place in looked]
    depths = compared_depths(some, [middles[place] for place in looked])
    overlap = _overlap(some, depths)
    angles = parallax(some, depths)
    with np.errstate(divide="ignore"):
        quality = overlap * np.minimum(1.0, np.minimum(angles / SMALL_ANGLE, LARGE_ANGLE / angles))
        covered = overlap * np.minimum(1.0, NEAR_ANGLE / angles)
    np.fill_diagonal(quality, 0.0)
    chosen = _grown(_best_pair(quality, covered), quality, covered, min(count, len(some)))
    pairs = [(i, j) for place, i in enumerate(chosen) for j in chosen[:place]]
    said = {
        "compared": len(some),
        "overlap": round(float(np.mean([overlap[pair] for pair in pairs])), 3),
        "parallax_degrees": round(float(np.degrees(np.mean([angles[pair] for pair in pairs]))), 2),
    }
    return Choice(tuple(sorted(looked[place] for place in chosen)), said)


def compared_depths(cameras: Sequence[Camera], middles: Sequence[float | None]) -> F64:
    """(V,) the z-depths at which two views or more are compared: where one is unknown the median of the known ones; if
    none is known, 0.7 of those of `scene_depths`."""
    depths = np.array(middles, dtype=np.float64)  # None becomes NaN
    known = np.isfinite(depths)
    return np.where(known, depths, np.median(depths[known])) if known.any() else BEFORE * scene_depths(cameras)


def scene_depths(cameras: Sequence[Camera]) -> F64:
    """(V,) z-depth in each view of what the others look at, in the cameras' units.

    The median over other views of the z-depth at which the optical axes come closest. Axes count if they differ by at
    least 2 degrees, come closest in front of both cameras, at least a tenth of the baseline from each, and within a
    tenth of the depth of each other. A view without such others gets the median over the views that have them; if none
    has, four times the largest baseline.
    """
    axes = np.stack([camera.rotation[:, 2] for camera in cameras])
    centers = np.stack([camera.center for camera in cameras]) - cameras[0].center
    between = centers[None] - centers[:, None]  # (V, V, 3) from i to j
    cosine = np.clip(axes @ axes.T, -1.0, 1.0)
    own, other = np.einsum("ijk,ik->ij", between, axes), np.einsum("ijk,jk->ij", between, axes)
    turned = 1.0 - cosine**2 >= np.sin(MIN_TURN) ** 2
    below = np.where(turned, 1.0 - cosine**2, 1.0)
    depth, depth_there = (own - cosine * other) / below, (cosine * own - other) / below
    apart = between + depth_there[:, :, None] * axes[None] - depth[:, :, None] * axes[:, None]
    miss = np.linalg.norm(apart, axis=2)
    nearer, way = np.minimum(depth, depth_there), np.linalg.norm(between, axis=2)
    meets = turned & (nearer > 0) & (nearer >= MIN_REACH * way) & (miss <= MAX_MISS * nearer)
    found = np.array([np.median(row[kept]) if kept.any() else np.nan for row, kept in zip(depth, meets, strict=True)])
    if np.isnan(found).all():
        largest = float(way.max())
        return np.full(len(cameras), PARALLEL_DEPTH * largest if largest > 0 else 1.0)
    return np.where(np.isnan(found), np.nanmedian(found), found)


def _overlap(cameras: Sequence[Camera], depths: F64) -> F64:
    """(V, V) share of each view, at its depth, that another sees; mean of both directions, 1 on the diagonal."""
    shares = seen_by(cameras, depths, cameras).mean(axis=2).T
    return 0.5 * (shares + shares.T)


def seen_by(cameras: Sequence[Camera], depths: F64, others: Sequence[Camera]) -> NDArray[np.bool_]:
    """(O, V, P) whether each of the others sees the points of a grid of each view, which lie at the view's depth."""
    grid = pixel_grid((GRID, GRID)) / GRID
    points = np.concatenate(
        [
            one.unproject(grid * (one.width, one.height), np.full(len(grid), depth))
            for one, depth in zip(cameras, depths, strict=True)
        ]
    )
    return np.stack([other.shows(*other.project(points)).reshape(len(cameras), -1) for other in others])


def parallax(cameras: Sequence[Camera], depths: F64) -> F64:
    """(V, V) parallax in radians: angle between two cameras from the centre point of a view; mean of both views."""
    centers = np.stack([camera.center for camera in cameras]) - cameras[0].center
    axes = np.stack([camera.rotation[:, 2] for camera in cameras])
    rays = (centers + depths[:, None] * axes)[:, None] - centers[None]  # (V, V, 3) from j to what i looks at
    cosine = np.einsum("ijk,ik->ij", rays, axes)
    sine = np.linalg.norm(np.cross(rays, axes[:, None]), axis=2)
    angles = np.arctan2(sine, cosine)
    return 0.5 * (angles + angles.T)


def _best_pair(quality: F64, covered: F64) -> list[int]:
    """Indices of the pair with the highest score; ties go to the earliest."""
    best, pair = -1.0, [0, 1]
    for i in range(len(quality) - 1):
        scores = quality[i, i + 1 :] * np.maximum(covered[i], covered[i + 1 :]).mean(axis=1)
        j = int(np.argmax(scores))
        if scores[j] > best:
            best, pair = float(scores[j]), [i, i + 1 + j]
    return pair


def _grown(chosen: list[int], quality: F64, covered: F64, count: int) -> list[int]:
    """Extend the chosen indices greedily to `count`, each time by the view with the highest score of the set."""
    while len(chosen) < count:
        best, place = -1.0, -1
        for candidate in range(len(quality)):
            if candidate in chosen:
                continue
            views = [*chosen, candidate]
            score = float(quality[np.ix_(views, views)].max(axis=1).mean() * covered[views].max(axis=0).mean())
            if score > best:
                best, place = score, candidate
        chosen = [*chosen, place]
    return chosen


def evenly(count: int, most: int) -> list[int]:
    """All indices, or `most` evenly spaced ones including the first and the last."""
    if count <= most:
        return list(range(count))
    return [int(place) for place in np.linspace(0, count - 1, most).round()]
