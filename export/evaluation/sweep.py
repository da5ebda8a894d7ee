"""Baseline depth without learning: plane sweep by ZNCC and colour, guided filtering, left-right consistency check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from gapmes.service.cameras.overlap import inverse_depth_steps
from gapmes.service.photographs.images import FittedView

from .warp import relative_rays, source_positions, warped

F32 = NDArray[np.float32]

PLANES = 96
MATCH_RADIUS = 3  # px; ZNCC in windows of 7 x 7
TEXTURELESS = 1e-8  # added to the product of variances, which damps the correlation of windows without texture
COLOUR_SHARE = 0.5  # of the truncated colour difference in the cost, the rest is ZNCC
COLOUR_LIMIT = 0.15  # truncation of the absolute colour difference
UNSEEN_COST = 0.4  # cost, 0..1, outside of the source: worse than a match, better than a clear mismatch
GUIDE_RADIUS, GUIDE_EPSILON = 7, 1e-3  # px and variance of grey: weaker edges are smoothed across
AGREEMENT = 0.03  # of the range of inverse depth: largest difference to the depth of the corresponding pixel
MEDIAN_RADIUS = 2  # px


@dataclass(frozen=True, eq=False)
class SweptDepths:
    """Depth of every input pixel, and a mask of those that another view confirms."""

    depths: F32  # (V, H, W) z-depth
    agreed: NDArray[np.bool_]  # (V, H, W)


def plainly_swept_depths(inputs: Sequence[FittedView], near: float, far: float) -> F32:
    """(V, H, W) z-depth: winner-take-all over planes uniform in inverse depth, with costs averaged in windows."""
    views = range(len(inputs))
    return torch.stack([_winners(inputs, index, near, far, guided=False) for index in views]).numpy()


def swept_depths(inputs: Sequence[FittedView], near: float, far: float) -> SweptDepths:
    """Winner-take-all over planes uniform in inverse depth, each view against all others.

    The cost volume is aggregated by a guided filter (He et al. 2010; Hosni et al. 2011) and the minimum refined by a
    parabola. Depths that no other view confirms are filled from the farther neighbour in the row; a median filter
    follows.
    """
    first = torch.stack([_winners(inputs, index, near, far, guided=True) for index in range(len(inputs))])
    tolerance = AGREEMENT * (1 / near - 1 / far)
    agreed = torch.stack([_agrees(inputs, first, index, tolerance) for index in range(len(inputs))]).numpy()
    filled = np.stack([filled_from_behind(z, ok) for z, ok in zip(first.numpy(), agreed, strict=True)])
    return SweptDepths(_median(torch.from_numpy(filled)).numpy(), agreed)


def filled_from_behind(depth: F32, known: NDArray[np.bool_]) -> F32:
    """(H, W): where not `known`, the farther of the nearest known depths to the left and right in the row.

    Occluded surfaces lie behind their neighbours. A row without known depths gets the median of all known ones.
    """
    width = depth.shape[1]
    columns = np.arange(width)
    left = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    from_left = np.take_along_axis(depth, np.maximum(left, 0), axis=1)
    from_right = np.take_along_axis(depth, np.minimum(right, width - 1), axis=1)
    behind = np.maximum(np.where(left >= 0, from_left, -np.inf), np.where(right < width, from_right, -np.inf))
    rest = np.median(depth[known]) if known.any() else np.median(depth)
    return np.where(known, depth, np.where(np.isfinite(behind), behind, rest)).astype(np.float32)


def _winners(inputs: Sequence[FittedView], index: int, near: float, far: float, *, guided: bool) -> Tensor:
    """(H, W) depth of minimum cost, aggregated by a guided filter or in windows."""
    view = inputs[index]
    depths = torch.from_numpy(inverse_depth_steps(near, far, PLANES).astype(np.float32)).reshape(-1, 1, 1)
    others = [other for j, other in enumerate(inputs) if j != index]
    cost = torch.stack([_matching_cost(view, other, depths) for other in others]).mean(dim=0)
    cost = (
        _guided(torch.from_numpy(view.image).mean(dim=0), cost) if guided else _box(cost[:, None], MATCH_RADIUS)[:, 0]
    )
    best = cost.argmin(dim=0, keepdim=True)
    inner = best.clamp(1, PLANES - 2)
    before, at, after = (cost.gather(0, inner + step)[0] for step in (-1, 0, 1))
    bend = (before - 2 * at + after).clamp(min=1e-6)
    step = torch.where(inner == best, (0.5 * (before - after) / bend).clamp(-0.5, 0.5), 0.0)[0]
    return 1 / (1 / near + (best[0] + step) * (1 / far - 1 / near) / (PLANES - 1))


def _matching_cost(view: FittedView, other: FittedView, depths: Tensor) -> Tensor:
    """(D, H, W) costs in 0..1: ZNCC of the grey pictures combined with the truncated colour difference."""
    image = torch.from_numpy(view.image)[None]
    colours, seen = warped(view.camera, other, depths)
    a, b = image.mean(dim=1, keepdim=True), colours.mean(dim=1, keepdim=True)
    mean_a, mean_b = _box(a, MATCH_RADIUS), _box(b, MATCH_RADIUS)
    var_a = (_box(a**2, MATCH_RADIUS) - mean_a**2).clamp(min=0)
    var_b = (_box(b**2, MATCH_RADIUS) - mean_b**2).clamp(min=0)
    covariance = _box(a * b, MATCH_RADIUS) - mean_a * mean_b
    correlation = (covariance / (var_a * var_b + TEXTURELESS).sqrt()).clamp(-1, 1)[:, 0]
    difference = (colours - image).abs().mean(dim=1).clamp(max=COLOUR_LIMIT) / COLOUR_LIMIT
    cost = (1 - COLOUR_SHARE) * (1 - correlation) / 2 + COLOUR_SHARE * difference
    return torch.where(seen, cost, UNSEEN_COST)


def _guided(guide: Tensor, cost: Tensor) -> Tensor:
    """Guided filter of every plane (D, H, W) by the grey picture (H, W)."""
    picture, planes = guide[None, None], cost[:, None]
    mean_g, mean_c = _box(picture, GUIDE_RADIUS), _box(planes, GUIDE_RADIUS)
    variance = _box(picture**2, GUIDE_RADIUS) - mean_g**2
    slope = (_box(picture * planes, GUIDE_RADIUS) - mean_g * mean_c) / (variance + GUIDE_EPSILON)
    level = mean_c - slope * mean_g
    return (_box(slope, GUIDE_RADIUS) * picture + _box(level, GUIDE_RADIUS))[:, 0]


def _agrees(inputs: Sequence[FittedView], depths: Tensor, index: int, tolerance: float) -> Tensor:
    """(H, W) mask of pixels whose corresponding pixel in another view has the same depth, within `tolerance` in 1/z."""
    camera, depth = inputs[index].camera, depths[index]
    agreed = torch.zeros(depth.shape, dtype=torch.bool)
    for j, other in enumerate(inputs):
        if j == index:
            continue
        x, y, seen = source_positions(camera, other.camera, depth[None])
        column = x[0].clamp(0, other.camera.width - 1).long()
        row = y[0].clamp(0, other.camera.height - 1).long()
        rays, offset = relative_rays(camera, other.camera)
        there = offset[2] + depth * rays[2]
        agreed |= seen[0] & ((1 / there - 1 / depths[j][row, column]).abs() < tolerance)
    return agreed


def _box(planes: Tensor, radius: int) -> Tensor:
    """Means of (n, c, H, W) over windows of 2 * radius + 1 px, truncated at the border."""
    size = 2 * radius + 1
    rows = F.avg_pool2d(planes, (1, size), 1, (0, radius), count_include_pad=False)
    return F.avg_pool2d(rows, (size, 1), 1, (radius, 0), count_include_pad=False)


def _median(depths: Tensor) -> Tensor:
    """Median filter of (V, H, W) in windows of 2 * `MEDIAN_RADIUS` + 1 px."""
    padded = F.pad(depths[:, None], (MEDIAN_RADIUS,) * 4, mode="replicate")
    return F.unfold(padded, 2 * MEDIAN_RADIUS + 1).median(dim=1).values.reshape(depths.shape)
