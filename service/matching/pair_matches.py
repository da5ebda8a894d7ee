"""Coarse matches of pairs of views, computed once and shared by all checks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import pixel_grid
from ..cameras.depth_range import DepthRange
from ..cameras.spanning_tree import first_joined
from ..photographs.bilinear import bilinear
from ..photographs.images import FittedView
from .coarse_views import coarse_view, nearest_neighbours, pairs_by_distance
from .depth_sweep import Matches, matches

F64 = NDArray[np.float64]


class PairMatches:
    """Lazily computed coarse matches of pairs of views; for use by one thread."""

    def __init__(self, views: Sequence[FittedView], depths: DepthRange) -> None:
        self.views = views
        self.coarse = [coarse_view(view) for view in views]
        self.depths = depths
        self._found: dict[tuple[int, int], list[Matches]] = {}

    def of(self, one: int, other: int) -> list[Matches]:
        """The matches of view `one` in `other`, then those of `other` in `one`; `Matches.other` is the place in the
        pair of the view that is matched with: 1, then 0."""
        pair = (one, other)
        if pair not in self._found:
            self._found[pair] = matches([self.coarse[one], self.coarse[other]], self.depths)
        return self._found[pair]

    def values(self, pair: tuple[int, int], maps: Sequence[F64]) -> Iterator[tuple[int, F64, F64]]:
        """The coarse maps (h, w, C) of the views sampled at the matches of a pair, in both directions: the place in the
        pair (0 or 1) of the view whose pixels match, (M, C) its own values there, and (M, C) those of the other view
        where it sees the same points, bilinear."""
        for place, match in enumerate(self.of(*pair)):
            view, other = self.coarse[pair[place]], self.coarse[pair[match.other]]
            pixels, depth = pixel_grid(match.depth.shape)[match.good], match.depth.ravel()[match.good]
            there, _ = other.camera.project(view.camera.unproject(pixels, depth))
            own = maps[pair[place]]
            theirs = bilinear(maps[pair[match.other]], *(there - 0.5).T)
            yield place, own.reshape(-1, own.shape[2])[match.good], theirs

    def nearest(self) -> list[tuple[int, int]]:
        """The pairs (i, j), i < j, of which one view is the nearest neighbour of the other, each once."""
        near = nearest_neighbours([view.camera for view in self.views])
        return list(dict.fromkeys((min(view, other), max(view, other)) for view, other in enumerate(near)))

    def joined(self) -> list[tuple[int, int]]:
        """`nearest`, and of further pairs the nearest that join views which those leave apart."""
        found = self.nearest()
        for one, other in pairs_by_distance([view.camera for view in self.views]):
            first = first_joined(len(self.views), found)
            if first[one] != first[other]:
                found.append((one, other))
        return found
