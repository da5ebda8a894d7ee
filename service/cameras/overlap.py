"""How much of each view the other views see at a given depth: frusta sampled by a grid of rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .camera import Camera, pixel_grid

F64 = NDArray[np.float64]

GRID = 12  # rays per side: shares are resolved to about 1 / 12 of the width, enough for every threshold here


def shared_shares(cameras: Sequence[Camera], depths: Sequence[float] | F64) -> F64:
    """(V, V, D): entry [i, j, d] is the share of view i's pixels that view j would see at z-depth `depths[d]`."""
    count = len(cameras)
    shares = np.ones((count, count, len(depths)))
    for i, one in enumerate(cameras):
        pixels = pixel_grid((GRID, GRID)) / GRID * (one.width, one.height)
        points = np.concatenate([one.unproject(pixels, np.full(len(pixels), z)) for z in depths])
        for j, other in enumerate(cameras):
            if i != j:
                shares[i, j] = other.shows(*other.project(points)).reshape(len(depths), -1).mean(axis=1)
    return shares


def best_partner_shares(cameras: Sequence[Camera], depths: Sequence[float] | F64) -> F64:
    """(V, D): per view and depth the largest overlap with one other view, as the mean of both directions' shares."""
    shares = shared_shares(cameras, depths)
    both = 0.5 * (shares + shares.transpose(1, 0, 2))
    both[np.arange(len(cameras)), np.arange(len(cameras))] = 0.0
    return both.max(axis=1)


def inverse_depth_steps(near: float, far: float, count: int) -> F64:
    """(count,) depths from near to far, uniform in inverse depth: about equal steps of parallax."""
    return 1.0 / np.linspace(1.0 / near, 1.0 / far, count)
