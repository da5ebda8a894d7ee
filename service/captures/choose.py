"""Choose the views of a capture that the network should see: those that share much, from places far enough apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..cameras.overlap import seen

F64 = NDArray[np.float64]

MAX_SCORED = 400  # views; of more, so many at equal distances in the file's order: cost grows with their square
GRID = 5  # rays per side of a view, for the share that another one sees
SMALL_ANGLE = np.radians(5.0)  # of parallax; below it depth is uncertain in proportion
LARGE_ANGLE = np.radians(25.0)  # above it views look different, and see past each other's edges
NEAR_ANGLE = np.radians(10.0)  # up to which what one view shows is still good from another
MIN_TURN = np.radians(2.0)  # between axes; below it, where they meet is chance
MAX_MISS = 0.1  # of the depth: axes that pass each other farther off than this do not look at one thing
MIN_REACH = 0.1  # of the way between two cameras: axes that meet closer to one of them meet at that camera itself
BEFORE = 0.7  # of the depth where axes meet: the scene begins before the thing that is looked at
PARALLEL_DEPTH = 4.0  # baselines, where no axes meet: the middle, in inverse depth, of what two views side by side see


@dataclass(frozen=True)
class Choice:
    """The chosen views' places, ascending, and what they were chosen by as plain JSON values."""

    places: tuple[int, ...]
    said: dict[str, Any]


def chosen_views(cameras: Sequence[Camera], count: int, near: float | None, far: float | None) -> Choice:
    """`count` of the cameras, or all where there are no more; the same for the same cameras.

    With o_ij the share of view i that view j sees at the depth of view i, mean of both directions, and a_ij the angle
    between the two cameras as seen from there, a pair has the quality q_ij = o_ij min(1, a_ij / 5 deg, 25 deg / a_ij),
    one view covers another by c_ij = o_ij min(1, 10 deg / a_ij), and a set has the score

        mean over its views of the largest q with another of it x mean over all views of the largest c with one of it.

    The pair with the highest score comes first, then one view after the other that keeps it highest; ties go to the
    earlier views. The depth is 2 / (1 / near + 1 / far) where both are known, else 0.7 of that of `scene_depths`.

    Of all pairs of five captures of 8 to 12 photographs, reconstructed and compared with the others, the chosen one
    loses 0.4 dB to the best with near and far and 0.9 dB without, the median pair 1.9 dB. The constants were set with
    four of them.
    """
    looked = _evenly(len(cameras), MAX_SCORED)
    some = [cameras[place] for place in looked]
    depths = BEFORE * scene_depths(some)
    if near is not None and far is not None and 0 < near < far:
        depths = np.full(len(some), 2.0 / (1.0 / near + 1.0 / far))
    overlap = _overlap(some, depths)
    angles = _angles(some, depths)
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


def scene_depths(cameras: Sequence[Camera]) -> F64:
    """(V,) how deep in each view the others look, in the cameras' units.

    The median over the other views, of the z-depth at which its axis comes closest to theirs; those count whose axes
    are turned by 2 degrees or more, meet in front of both, a tenth of the way between the two cameras or more from
    each, and miss each other by less than a tenth of the depth. A view without such others gets the median of those
    that have them; where none has, four times the largest baseline.
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
    """(V, V) share of each view, at its depth, that each other one sees; mean of both directions, 1 with itself."""
    places = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    points = np.concatenate(
        [
            one.unproject(grid * (one.width, one.height), np.full(len(grid), depth))
            for one, depth in zip(cameras, depths, strict=True)
        ]
    )
    shares = np.stack([seen(other, points).reshape(len(cameras), -1).mean(axis=1) for other in cameras], axis=1)
    return 0.5 * (shares + shares.T)


def _angles(cameras: Sequence[Camera], depths: F64) -> F64:
    """(V, V) radians between two cameras as seen from the point in the middle of a view; mean of both views."""
    centers = np.stack([camera.center for camera in cameras]) - cameras[0].center
    axes = np.stack([camera.rotation[:, 2] for camera in cameras])
    rays = (centers + depths[:, None] * axes)[:, None] - centers[None]  # (V, V, 3) from j to what i looks at
    cosine = np.einsum("ijk,ik->ij", rays, axes)
    sine = np.linalg.norm(np.cross(rays, axes[:, None]), axis=2)
    angles = np.arctan2(sine, cosine)
    return 0.5 * (angles + angles.T)


def _best_pair(quality: F64, covered: F64) -> list[int]:
    """The places of the pair with the highest score, the earliest of those that share it."""
    best, pair = -1.0, [0, min(1, len(quality) - 1)]
    for i in range(len(quality) - 1):
        scores = quality[i, i + 1 :] * np.maximum(covered[i], covered[i + 1 :]).mean(axis=1)
        j = int(np.argmax(scores))
        if scores[j] > best:
            best, pair = float(scores[j]), [i, i + 1 + j]
    return pair


def _grown(chosen: list[int], quality: F64, covered: F64, count: int) -> list[int]:
    """The chosen places with further ones, each of which gives the highest score of the set."""
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


def _evenly(count: int, most: int) -> list[int]:
    """All places, or `most` of them at equal distances, the first and the last among them."""
    if count <= most:
        return list(range(count))
    return [int(place) for place in np.linspace(0, count - 1, most).round()]
