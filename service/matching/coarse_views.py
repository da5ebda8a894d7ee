"""Small grey copies of the views, and warping them onto fronto-parallel planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera, pixel_grid
from ..cameras.rotations import rotated
from ..photographs.images import FittedView

F64 = NDArray[np.float64]

MIN_BASELINE = 0.05  # of the largest distance: depth from a shorter baseline is too coarse to check anything
COARSE_SIDE = 64  # px; enough to tell right poses from wrong ones and near from far
ENOUGH = 0.25  # of a cell that a mask must keep: 4 px of 16 still have a mean, and a dithered mask leaves a picture


@dataclass(frozen=True)
class CoarseView:
    """A view averaged over square blocks of pixels, its cells."""

    grey: F64  # (h, w) in [0, 1], mean over the kept pixels of a cell
    kept: NDArray[np.bool_]  # (h, w) cells of which the mask keeps a quarter or more
    camera: Camera


def coarse_view(view: FittedView) -> CoarseView:
    """`view` in grey, averaged over whole blocks so that its shorter side has at least COARSE_SIDE px, where it has so
    many, and less than twice that; mask and camera follow."""
    block = block_px(view)
    share = block_means(view.kept.astype(np.float64), block)
    grey = kept_block_means(view.grey, view.kept, share, block)
    rows, columns = grey.shape
    camera = view.camera.cropped(0, 0, columns * block, rows * block).resized(columns, rows)
    return CoarseView(grey, share >= ENOUGH, camera)


def block_px(view: FittedView) -> int:
    """The side in px of the square that becomes a cell."""
    return max(1, min(view.image.shape[1:]) // COARSE_SIDE)


def block_means(values: NDArray, block: int) -> NDArray:
    """(h // block, w // block) means over whole blocks of (h, w) values."""
    rows, columns = values.shape[0] // block, values.shape[1] // block
    return values[: rows * block, : columns * block].reshape(rows, block, columns, block).mean(axis=(1, 3))


def kept_block_means(values: NDArray, kept: NDArray[np.bool_], share: F64, block: int) -> F64:
    """(h // block, w // block) means of the `kept` ones of (h, w) values in each block, 0 where it has none; `share` is
    the block's share of kept pixels."""
    return block_means(np.where(kept, values, 0.0), block) / np.where(share > 0, share, 1.0)


def warp_to(shape: tuple[int, int], camera: Camera, source: CoarseView, depths: F64) -> tuple[F64, NDArray[np.bool_]]:
    """`source` warped to `camera` by the plane at each of the z-depths `depths` (D,): (D, h, w) grey, bilinear, and
    (D, h, w) where it is seen: inside the picture, between four kept cells.
    """
    rows, columns = shape
    rays = rotated(source.camera.rotation.T, camera.rays(pixel_grid(shape)))
    offset = (camera.center - source.camera.center) @ source.camera.rotation
    points = offset + depths[:, None, None] * rays
    front = points[..., 2] > 0
    z = np.where(front, points[..., 2], 1.0)
    x = source.camera.fx * points[..., 0] / z + source.camera.cx - 0.5
    y = source.camera.fy * points[..., 1] / z + source.camera.cy - 0.5
    height, width = source.grey.shape
    seen = front & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(seen, x, 0.0), np.where(seen, y, 0.0)
    i, j = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
    kept = source.kept[:-1] & source.kept[1:]
    seen &= (kept[:, :-1] & kept[:, 1:])[j, i]
    a, b = x - i, y - j
    flat, corner = source.grey.ravel(), j * width + i
    upper = (1 - a) * flat[corner] + a * flat[corner + 1]
    lower = (1 - a) * flat[corner + width] + a * flat[corner + width + 1]
    return ((1 - b) * upper + b * lower).reshape(-1, rows, columns), seen.reshape(-1, rows, columns)


def nearest_neighbours(cameras: Sequence[Camera]) -> list[int]:
    """Per camera the index of the nearest other one at a distance of at least MIN_BASELINE times the largest distance.

    There always is one: of the two cameras that are farthest apart, one is at least half their distance away.
    """
    return [int(index) for index in _distances(cameras).argmin(axis=1)]


def pairs_by_distance(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """All pairs (i, j), i < j, at such a distance, nearest first."""
    distances = _distances(cameras)
    pairs = [pair for pair in combinations(range(len(cameras)), 2) if np.isfinite(distances[pair])]
    return sorted(pairs, key=lambda pair: float(distances[pair]))


def _distances(cameras: Sequence[Camera]) -> F64:
    """(V, V) between the cameras; infinite below MIN_BASELINE times the largest."""
    centers = np.stack([camera.center for camera in cameras])
    distances = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    distances[distances < MIN_BASELINE * distances.max()] = np.inf
    np.fill_diagonal(distances, np.inf)
    return np.asarray(distances)
