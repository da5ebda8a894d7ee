"""Depth candidates of unconfirmed pixels, and the features that the choice network scores them by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...matching.confirmed import confirmed
from ...matching.correspondence import reprojected, views_with_parallax
from ...matching.match_cost import LIMIT, CostAggregation, difference_there, features
from ...matching.plane_means import plane_means
from ...matching.window_match import contrast
from ...photographs.images import FittedView
from ..surfaces import LEAST, Described, described_surface

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACHES = (
    (6.0, True),
    (24.0, True),
    (64.0, True),
    (6.0, False),
    (24.0, False),
)  # of fitted surfaces: px, and whether image edges limit them
FREE = 3  # candidates of no surface: the current depth, the large network's, and that before plane continuation
COUNT = FREE + len(REACHES)
KNOWN, ABOUT = 14, 7  # features of each candidate, and of each pixel
NEAR, FAR = 4.0, 32.0  # px of parallax: scales of differences
MOST = 16.0  # px: distances to another view's surface are clipped at it
NEARBY = 0.01  # total weight from which the confirmed pixels of a surface are near
ALIKE = 1.5  # px: closer candidates count as the same depth
CONTRAST = 0.05  # scale of the contrast feature, which is clipped at twice this


class Candidates(NamedTuple):
    """The candidates of one view with N undecided pixels; inverse depths are in px of parallax in the other view with
    the longest baseline."""

    inverse: F64  # (COUNT, H, W)
    known: NDArray[np.float16]  # (COUNT, KNOWN, N)
    about: NDArray[np.float16]  # (ABOUT, N)
    undecided: Mask  # (H, W) kept pixels that no other view confirms
    outside: Mask  # (H, W) pixels outside every other view's picture, at their current depth
    nearby: Mask  # (COUNT, H, W) where one is a surface that image edges limit, and that is confirmed nearby
    disparity_scale: float  # px per unit of inverse depth


class Matched:
    """Views with their current `depths` and two `others`: each (V, H, W) z-depths in the cameras' units."""

    def __init__(self, views: Sequence[FittedView], depths: F64, others: Sequence[F64]) -> None:
        self.views, self.depths, self.others = views, depths, others
        self.sure = confirmed(views, depths)
        self.pictures = [features(view) for view in views]
        self.surfaces = [np.stack([1 / depth, sure], axis=-1) for depth, sure in zip(depths, self.sure, strict=True)]

    def candidates(self, index: int) -> Candidates | None:
        """The candidates of view `index`; None where none of its pixels is confirmed, all are decided, or no other view
        has parallax."""
        view, depth, sure = self.views[index], self.depths[index], self.sure[index]
        scales, undecided = views_with_parallax(self.views, index, depth), view.kept & ~sure
        if not scales or not sure.any() or not undecided.any():
            return None
        scale = max(scales.values())
        known = np.zeros((COUNT, KNOWN, int(undecided.sum())), np.float16)
        inverse, nearby = np.empty((COUNT, *depth.shape)), np.zeros((COUNT, *depth.shape), np.bool_)
        inverse[:FREE] = scale / np.stack([depth, *(stack[index] for stack in self.others)])
        for place, (reach, edges) in enumerate(REACHES, start=FREE):
            found = described_surface(view.image, inverse[0], sure, reach, edges=edges)
            inverse[place] = found.surface.within(inverse[0], view.kept)
            nearby[place] = edges and found.surface.weight >= NEARBY
            known[place, 4:7] = _of_surface(found, undecided)
        self._compared(index, scales, inverse, undecided, known)
        about = _about(view, inverse, undecided)
        return Candidates(inverse, known, about, undecided, self._outside(index, scales), nearby, scale)

    def _compared(
        self, index: int, scales: Mapping[int, float], inverse: F64, undecided: Mask, known: NDArray[np.float16]
    ) -> None:
        """Fill in all features of `known` but those of the surfaces."""
        aggregation, of_all = CostAggregation(self.views[index], self.views[index].kept), inverse[:, undecided]
        middle = np.median(of_all, axis=0)
        for place, own in enumerate(of_all):
            seen = self._seen(index, scales, max(scales.values()) / inverse[place], aggregation)
            cost, share, front, sure = (plane[undecided] for plane in seen)
            alike = np.mean(np.abs(of_all - own) < ALIKE, axis=0)
            known[place, :4] = [np.tanh((own - other) / px) for other in of_all[:2] for px in (NEAR, FAR)]
            from_middle, level = np.tanh((own - middle) / NEAR), np.log1p(own) / 5
            known[place, 7:] = [cost / LIMIT, share, np.tanh(front / 2), sure, from_middle, alike, level]

    def _outside(self, index: int, scales: Mapping[int, float]) -> Mask:
        """(H, W) pixels outside every other view's picture."""
        view, depth = self.views[index], self.depths[index]
        return ~np.any([reprojected(view, depth, self.views[other]).inside for other in scales], axis=0)

    def _seen(
        self, index: int, scales: Mapping[int, float], depth: F64, aggregation: CostAggregation
    ) -> tuple[F64, F64, F64, F64]:
        """(H, W) each, over the other views: the least aggregated matching cost; the share of them that see the point;
        the largest distance in px by which it lies in front of their surface; and whether that surface is confirmed."""
        view, own = self.views[index], self.pictures[index]
        cost, share = np.full(depth.shape, LIMIT), np.zeros(depth.shape)
        front, sure = np.full(depth.shape, -MOST), np.zeros(depth.shape)
        for other, scale in scales.items():
            seen = reprojected(view, depth, self.views[other])
            now = view.kept * difference_there(own, seen, self.pictures[other])
            cost = np.minimum(cost, aggregation.of(now))
            share += seen.where / len(scales)
            theirs = seen.value(self.surfaces[other])
            gap = np.where(seen.where, np.clip((1 / seen.z - theirs[..., 0]) * scale, -MOST, MOST), -MOST)
            sure = np.where(gap > front, theirs[..., 1], sure)
            front = np.maximum(front, gap)
        return cost, share, np.where(share > 0, front, 0.0), np.where(share > 0, sure, 0.0)


def _of_surface(found: Described, undecided: Mask) -> NDArray[np.float64]:
    """(3, N) features of the surface at each pixel: its weight, its residual, and the distance of its support."""
    known = found.surface.known[undecided]
    weight = np.log10(np.maximum(found.surface.weight[undecided], LEAST)) / -np.log10(LEAST)
    return np.stack(
        [weight, np.tanh(found.residual[undecided] / 2) * known, np.tanh(found.away[undecided] / 2) * known]
    )


def _about(view: FittedView, inverse: F64, undecided: Mask) -> NDArray[np.float16]:
    """(ABOUT, N) features of each undecided pixel."""
    y, x = (np.arange(count) for count in undecided.shape)
    border = np.minimum(np.minimum(y, y[::-1])[:, None], np.minimum(x, x[::-1]))
    low, high = inverse[0][view.kept].min(), inverse[0][view.kept].max()
    texture = contrast(view.grey, view.kept, plane_means) / CONTRAST
    of_all = inverse[:, undecided]
    now, network, middle = of_all[0], of_all[1], np.median(of_all, axis=0)
    about = (
        np.log1p(border[undecided]) / 4,
        np.minimum(texture[undecided], 2),
        np.tanh((middle - now) / NEAR),
        np.tanh(of_all.std(axis=0) / NEAR),
        np.full(now.shape, 1 - undecided.sum() / view.kept.sum()),
        (now - low) / max(high - low, np.finfo(np.float64).tiny),
        np.tanh((now - network) / NEAR),
    )
    return np.stack(about).astype(np.float16)
