"""Planes through what is confirmed about each pixel of a view, and how sure they are.

A wall or a floor goes on where its texture ends, or where one view alone shows it. The inverse depth of a plane is
linear in the pixel's position, so that what is confirmed about it tells the rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..matching.plane_kernels import spread_along_rows, spread_down_columns

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE = 0.2  # sum over a change in the three channels that is as far as a reach is
RIDGE = 0.02  # of the reach squared: variance of positions below which slopes fade
LEAST = 1e-9  # weight below which nothing that is confirmed is near


class Surface(NamedTuple):
    """For every pixel a plane through what is confirmed about it."""

    inverse: F64  # (H, W) inverse depth at the pixel
    weight: F64  # (H, W) of all that is confirmed

    @property
    def known(self) -> Mask:
        """(H, W) where anything confirmed is near enough."""
        return self.weight > LEAST

    def within(self, inverse: F64, kept: Mask) -> F64:
        """(H, W) inverse depth within the range of what is `kept` of `inverse` (H, W), and that where none is known."""
        return np.where(self.known, np.clip(self.inverse, inverse[kept].min(), inverse[kept].max()), inverse)


class Described(NamedTuple):
    """A surface, and how far what it goes through is from it."""

    surface: Surface
    spread: F64  # (H, W) standard deviation of the confirmed inverse depths from the plane
    away: F64  # (H, W) from the pixel to their middle, in reaches


class _Moments(NamedTuple):
    """(H, W) each, of the confirmed pixels about every one, but for the steps."""

    steps: tuple[F64, F64]
    level: F64  # mean of their inverse depths
    beside: F64  # from their middle to the pixel, px
    below: F64
    across: F64  # slopes of the plane, times `size`
    down: F64
    size: F64
    along_x: F64  # how inverse depths vary with positions
    along_y: F64


def surface(picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float) -> Surface:
    """Planes fitted to the inverse depths (H, W) of the pixels that are `sure` (H, W), by least squares.

    They weigh by their distance along rows and columns, with `reach` px as the standard deviation; edges of `picture`
    (3, H, W) lengthen the way (domain transform, Gastal and Oliveira 2011).
    """
    return _fitted(picture, inverse, sure, reach, edges=True)[0]


def described_surface(
    picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float, *, edges: bool = True
) -> Described:
    """The same with what it goes through, where `edges` need not matter; the unit of `spread` is that of `inverse`."""
    found, moments = _fitted(picture, inverse, sure, reach, edges)
    squares = _spread(inverse * inverse * sure, *moments.steps)
    squares /= np.maximum(found.weight, LEAST)
    squares -= moments.level**2
    squares -= (moments.across * moments.along_x + moments.down * moments.along_y) / moments.size
    spread = np.sqrt(np.maximum(squares, 0))
    return Described(found, spread, np.hypot(moments.beside, moments.below) / reach)


def _fitted(
    picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float, edges: bool
) -> tuple[Surface, _Moments]:
    y, x = (np.arange(count, dtype=np.float64) for count in inverse.shape)
    y, one, d = y[:, None], np.ones((1, 1)), inverse
    terms = ((one, one), (x, one), (y, one), (x, x), (x, y), (y, y), (d, one), (d, x), (d, y))
    steps = _steps(picture, 2, reach, edges), _steps(picture, 1, reach, edges)
    mass, mean_x, mean_y, xx, xy, yy, level, xd, yd = (_spread(a * b * sure, *steps) for a, b in terms)
    ridge = RIDGE * reach**2
    for total in (mean_x, mean_y, xx, xy, yy, level, xd, yd):  # all in place: of a finer grid this is much memory
        total /= np.maximum(mass, LEAST)
    for spread, mean in ((xx, mean_x), (yy, mean_y)):
        spread -= mean**2
        np.maximum(spread, 0, out=spread)
        spread += ridge
    xy -= mean_x * mean_y
    xd -= mean_x * level
    yd -= mean_y * level
    across, down, size = yy * xd - xy * yd, xx * yd - xy * xd, xx * yy - xy**2
    beside, below = x - mean_x, y - mean_y
    found = level + (across * beside + down * below) / size
    return Surface(found, mass), _Moments(steps, level, beside, below, across, down, size, xd, yd)


def _spread(plane: F64, across: F64, down: F64) -> F64:
    """(H, W) weighted sums of `plane` over the pixels about each, along its row, then along columns, where `across`
    (H, W - 1) and `down` (H - 1, W) are what a step multiplies a weight by."""
    along, sums = np.empty_like(plane[None]), np.empty_like(plane[None])
    spread_along_rows(plane[None], across, along)
    spread_down_columns(along, down, sums)
    return sums[0]


def _steps(picture: NDArray[np.floating], axis: int, reach: float, edges: bool) -> F64:
    """(H, W - 1) or (H - 1, W) what a step to the next pixel of a row or column of (3, H, W) multiplies a weight by:
    exp(-sqrt(2) d / reach) for a way d, in which, with `edges`, a change of EDGE counts like `reach` px."""
    change = np.abs(np.diff(picture.astype(np.float64), axis=axis)).sum(axis=0)
    return np.ascontiguousarray(np.exp(-np.sqrt(2) / reach * (1 + edges * reach / EDGE * change)))
