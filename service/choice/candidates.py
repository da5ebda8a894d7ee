"""Candidates for the depths that no other view confirms, and what is known of each: what the choice is made by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..confirmed import confirmed
from ..correspondence import from_elsewhere, seen_by
from ..images import FittedView
from ..match_cost import LIMIT, Gathering, difference, features
from ..surfaces import LEAST, surface
from ..window_match import contrast

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACHES = (
    (6.0, True),
    (24.0, True),
    (64.0, True),
    (6.0, False),
    (24.0, False),
)  # of surfaces: px, and whether edges end them
FREE = 3  # candidates that are of no surface: the depth as it is, the network's own and that before planes
COUNT = FREE + len(REACHES)
KNOWN, ABOUT = 14, 7  # numbers of each candidate, and of each pixel
NEAR, FAR = 4.0, 32.0  # px of parallax: scales of differences
MOST = 16.0  # px: farther in front of or behind another view's surface is as far as can be
ALIKE = 1.5  # px: candidates that are closer stand for one depth
CONTRAST = 0.05  # of a window of grey, the scale; twice as much is as much as can be


class Candidates(NamedTuple):
    """Of one view, with N pixels that have a choice; inverse depths are in px of parallax, in the view that is farthest
    away."""

    inverse: F64  # (COUNT, H, W)
    known: NDArray[np.float16]  # (COUNT, KNOWN, N)
    about: NDArray[np.float16]  # (ABOUT, N)
    open: Mask  # (H, W) which pixels have a choice: kept ones that nothing confirms
    outside: Mask  # (H, W) which of all pixels no other view has in its picture, at the depth as it is
    way: float  # px per unit of inverse depth


class Matched:
    """Views with their depths as they are, and two `others`: stacks (V, H, W) of z-depths in the cameras' units."""

    def __init__(self, views: Sequence[FittedView], depths: F64, others: Sequence[F64]) -> None:
        self.views, self.depths, self.others = views, depths, others
        self.sure = confirmed(views, depths)
        self.pictures = [features(view) for view in views]

    def candidates(self, index: int) -> Candidates | None:
        """Of view `index`; nothing where nothing in it is confirmed, or no other view is elsewhere."""
        view, depth, sure = self.views[index], self.depths[index], self.sure[index]
        ways, choice = from_elsewhere(self.views, index, depth), view.kept & ~sure
        if not ways or not sure.any() or not choice.any():
            return None
        way = max(ways.values())
        known = np.zeros((COUNT, KNOWN, int(choice.sum())), np.float16)
        inverse = np.empty((COUNT, *depth.shape))
        inverse[:FREE] = way / np.stack([depth, *(stack[index] for stack in self.others)])
        for place, (reach, edges) in enumerate(REACHES, start=FREE):
            inverse[place], known[place, 4:7] = _of_surface(view, inverse[0], sure, choice, reach, edges)
        outside = self._compared(index, ways, inverse, choice, known)
        return Candidates(inverse, known, _about(view, inverse, choice), choice, outside, way)

    def _compared(
        self, index: int, ways: Mapping[int, float], inverse: F64, choice: Mask, known: NDArray[np.float16]
    ) -> Mask:
        """Fills in what of `known` tells candidates apart; returns which pixels no other view has in its picture."""
        gathering, middle = Gathering(self.views[index], self.views[index].kept), np.median(inverse, axis=0)
        outside = choice
        for place, own in enumerate(inverse):
            depth = max(ways.values()) / np.maximum(own, np.finfo(np.float64).tiny)
            cost, share, front, sure = self._seen(index, ways, depth, gathering)
            if place == 0:
                outside = share == 0
            apart = [np.tanh((own - other) / scale) for other in inverse[:2] for scale in (NEAR, FAR)]
            alike = np.mean([np.abs(other - own) < ALIKE for other in inverse], axis=0)
            rest = (cost / LIMIT, share, np.tanh(front / 2), sure, np.tanh((own - middle) / NEAR), alike)
            size = np.log1p(np.maximum(own, 0)) / 5
            for number, plane in zip((0, 1, 2, 3, *range(7, KNOWN)), (*apart, *rest, size), strict=True):
                known[place, number] = plane[choice]
        return outside

    def _seen(
        self, index: int, ways: Mapping[int, float], depth: F64, gathering: Gathering
    ) -> tuple[F64, F64, F64, F64]:
        """(H, W) each, of all other views: least gathered difference of the photographs; share of them that have the
        point in their picture; by how many px it stands in front of their surface, the most; whether that is sure."""
        view, own = self.views[index], self.pictures[index]
        cost, share = np.full(depth.shape, LIMIT), np.zeros(depth.shape)
        front, sure = np.full(depth.shape, -MOST), np.zeros(depth.shape)
        for other, way in ways.items():
            seen = seen_by(view, depth, self.views[other])
            now = view.kept * difference(view, own, depth, self.views[other], self.pictures[other])
            cost = np.minimum(cost, gathering.of(now))
            share += seen.where / len(ways)
            theirs = seen.value(np.stack([1 / self.depths[other], self.sure[other]], axis=-1))
            gap = np.where(seen.where, np.clip((1 / seen.z - theirs[..., 0]) * way, -MOST, MOST), -MOST)
            sure = np.where(gap > front, theirs[..., 1], sure)
            front = np.maximum(front, gap)
        return cost, share, np.where(share > 0, front, 0.0), np.where(share > 0, sure, 0.0)


def _of_surface(
    view: FittedView, inverse: F64, sure: Mask, choice: Mask, reach: float, edges: bool
) -> tuple[F64, NDArray[np.float64]]:
    """(H, W) within the range of what is kept, the depth as it is where no surface is near; and (3, N) of the choice:
    how much is confirmed about it, how far that lies off the plane and how far away."""
    low, high = inverse[view.kept].min(), inverse[view.kept].max()
    found = surface(view.image, inverse, sure, reach, edges=edges)
    known = found.known[choice]
    weight = np.log10(np.maximum(found.weight[choice], LEAST)) / -np.log10(LEAST)
    says = weight, np.tanh(found.spread[choice] / 2) * known, np.tanh(found.away[choice] / 2) * known
    return np.where(found.known, np.clip(found.inverse, low, high), inverse), np.stack(says)


def _about(view: FittedView, inverse: F64, choice: Mask) -> NDArray[np.float16]:
    """(ABOUT, N)"""
    now, network, middle = inverse[0], inverse[1], np.median(inverse, axis=0)
    y, x = (np.arange(count) for count in now.shape)
    border = np.minimum(np.minimum(y, y[::-1])[:, None], np.minimum(x, x[::-1]))
    low, high = now[view.kept].min(), now[view.kept].max()
    texture = contrast(view.image.mean(axis=0, dtype=np.float64), view.mask) / CONTRAST
    about = (
        np.log1p(border) / 4,
        np.minimum(texture, 2),
        np.tanh((middle - now) / NEAR),
        np.tanh(inverse.std(axis=0) / NEAR),
        np.full(now.shape, 1 - choice.sum() / view.kept.sum()),
        (now - low) / max(high - low, np.finfo(np.float64).tiny),
        np.tanh((now - network) / NEAR),
    )
    return np.stack([plane[choice] for plane in about]).astype(np.float16)
