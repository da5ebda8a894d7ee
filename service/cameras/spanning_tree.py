"""Which cameras are neighbours: the edges of the minimum spanning tree of their centres, and what edges join."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from .camera import Camera

# Decimals of a length as a share of the longest: edges that agree in them tie, so that rounding decides nothing.
DIGITS = 6


def minimum_spanning_tree(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """The V - 1 edges (i, j), i < j, of the minimum spanning tree of V camera centres (Kruskal 1956), sorted.

    Cameras along a path are joined each to the next. The order of the cameras does not matter unless edges tie in
    length: then those with the smaller j - i are preferred.
    """
    centers = np.stack([camera.center for camera in cameras])
    lengths = {(i, j): float(np.linalg.norm(centers[i] - centers[j])) for i, j in combinations(range(len(cameras)), 2)}
    longest = max(lengths.values(), default=0.0) or 1.0
    part = list(range(len(cameras)))  # the connected component of each camera
    edges = []
    for i, j in sorted(lengths, key=lambda pair: (round(lengths[pair] / longest, DIGITS), pair[1] - pair[0], pair)):
        if part[i] != part[j]:
            edges.append((i, j))
            part = [part[i] if one == part[j] else one for one in part]
    return sorted(edges)


def first_joined(count: int, edges: Iterable[tuple[int, int]]) -> list[int]:
    """Of each of so many cameras the lowest index that the edges join it with, its own where none does."""
    first = list(range(count))
    for i, j in edges:
        low, high = sorted((first[i], first[j]))
        first = [low if one == high else one for one in first]
    return first
