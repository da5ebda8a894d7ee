"""Which cameras are neighbours: the shortest ways that join all of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from .camera import Camera

DIGITS = 6  # of a way's share of the longest; ways that agree in them are equally long: rounding decides nothing


def shortest_ways(cameras: Sequence[Camera]) -> list[tuple[Camera, Camera]]:
    """The minimum spanning tree of the camera centres (Kruskal 1956): one way less than there are cameras.

    Cameras along a path are joined each to the next. Each way leads from the camera that comes first, and ways come in
    the order of these. Which ways they are does not depend on the order of the cameras, unless several are equally
    long: then those between cameras that come closer after each other are taken.
    """
    centers = np.stack([camera.center for camera in cameras])
    lengths = {(i, j): float(np.linalg.norm(centers[i] - centers[j])) for i, j in combinations(range(len(cameras)), 2)}
    longest = max(lengths.values(), default=0.0) or 1.0
    part = list(range(len(cameras)))  # cameras that are joined have the same
    ways = []
    for i, j in sorted(lengths, key=lambda pair: (round(lengths[pair] / longest, DIGITS), pair[1] - pair[0], pair)):
        if part[i] != part[j]:
            ways.append((i, j))
            part = [part[i] if one == part[j] else one for one in part]
    return [(cameras[i], cameras[j]) for i, j in sorted(ways)]
