"""Planes fitted through the confirmed pixels around each pixel of a view, with their residuals.

A wall or a floor continues where its texture ends, or where only one view shows it. The inverse depth of a plane is
linear in the pixel position, so that a linear fit to the confirmed pixels extends it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..matching.plane_kernels import spread_along_rows, spread_down_columns

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE = 0.2  # change of colour, summed over the channels, that counts like a distance of one reach
RIDGE = 0.02  # of the reach squared, added to the variances of positions: regularises the slopes
LEAST = 1e-9  # total weight below which no confirmed pixel is near enough


class Surface(NamedTuple):
    """The local plane of every pixel, evaluated at the pixel."""

    inverse: F64  # (H, W) inverse depth at the pixel
    weight: F64  # (H, W) total weight of the confirmed pixels

    @property
    def known(self) -> Mask:
        """(H, W) where confirmed pixels are near enough."""
        return self.weight > LEAST

    def within(self, inverse: F64, kept: Mask) -> F64:
        """(H, W) the surface, clipped to the range of `inverse` (H, W) over the `kept` pixels; `inverse` where it is
        not known."""
        return np.where(self.known, np.clip(self.inverse, inverse[kept].min(), inverse[kept].max()), inverse)


class Described(NamedTuple):
    """A surface, the residual of its fit, and how far away its support lies."""

    surface: Surface
    residual: F64  # (H, W) root of the variance of the confirmed inverse depths that the plane does not explain
    away: F64  # (H, W) distance from the pixel to the centroid of the confirmed pixels, in reaches


class _Moments(NamedTuple):
    """Weighted moments of the confirmed pixels around each pixel: (H, W) each, but for the steps."""

    steps: tuple[F64, F64]  # see `_steps`: along rows, along columns
    level: F64  # mean of their inverse depths
    beside: F64  # from their centroid to the pixel, px: x,
    below: F64  # and y
    across: F64  # slope of the plane along x, times `determinant`
    down: F64  # and along y
    determinant: F64  # determinant of the covariance of their positions
    along_x: F64  # covariance of inverse depth and x
    along_y: F64  # and y


def surface(picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float) -> Surface:
    """Weighted least-squares planes through the inverse depths `inverse` (H, W) of the confirmed pixels `sure` (H, W).

    Weights fall off with the distance along rows and columns, with a standard deviation of `reach` px; edges of
    `picture` (3, H, W) lengthen that distance (domain transform, Gastal and Oliveira 2011).
    """
    return _fitted(picture, inverse, sure, reach, edges=True)[0]


def described_surface(
    picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float, *, edges: bool = True
) -> Described:
    """As `surface`, with the quality of the fit; without `edges` the picture does not matter.

    `residual`, in the unit of `inverse`, is sqrt(S - b . c) of the variance S, the covariances c with x and y and the
    slopes b: the standard deviation from a plane without a ridge, and more where the ridge flattens the plane, since
    it is counted too. The choice among depths was trained on this number.
    """
    found, moments = _fitted(picture, inverse, sure, reach, edges)
    squares = _weighted_sums(inverse * inverse * sure, *moments.steps)
    squares /= np.maximum(found.weight, LEAST)
    squares -= moments.level**2
    squares -= (moments.across * moments.along_x + moments.down * moments.along_y) / moments.determinant
    residual = np.sqrt(np.maximum(squares, 0))
    return Described(found, residual, np.hypot(moments.beside, moments.below) / reach)


def _fitted(
    picture: NDArray[np.floating], inverse: F64, sure: Mask, reach: float, edges: bool
) -> tuple[Surface, _Moments]:
    """The planes of `surface` by the normal equations of the fit, and the moments that these are made of."""
    y, x = (np.arange(count, dtype=np.float64) for count in inverse.shape)
    y, one, d = y[:, None], np.ones((1, 1)), inverse
    terms = ((one, one), (x, one), (y, one), (x, x), (x, y), (y, y), (d, one), (d, x), (d, y))
    steps = _steps(picture, 2, reach, edges), _steps(picture, 1, reach, edges)
    weight, mean_x, mean_y, xx, xy, yy, level, xd, yd = (_weighted_sums(a * b * sure, *steps) for a, b in terms)
    ridge = RIDGE * reach**2
    for total in (mean_x, mean_y, xx, xy, yy, level, xd, yd):  # all in place: of a finer grid this is much memory
        total /= np.maximum(weight, LEAST)
    for variance, mean in ((xx, mean_x), (yy, mean_y)):
        variance -= mean**2
        np.maximum(variance, 0, out=variance)
        variance += ridge
    xy -= mean_x * mean_y
    xd -= mean_x * level
    yd -= mean_y * level
    across, down, determinant = yy * xd - xy * yd, xx * yd - xy * xd, xx * yy - xy**2
    beside, below = x - mean_x, y - mean_y
    found = level + (across * beside + down * below) / determinant
    return Surface(found, weight), _Moments(steps, level, beside, below, across, down, determinant, xd, yd)


def _weighted_sums(plane: F64, across: F64, down: F64) -> F64:
    """(H, W) weighted sums of `plane` (H, W) around each pixel, by a recursive filter along rows, then columns;
    `across` (H, W - 1) and `down` (H - 1, W) are its factors per step."""
    along, sums = np.empty_like(plane[None]), np.empty_like(plane[None])
    spread_along_rows(plane[None], across, along)
    spread_down_columns(along, down, sums)
    return sums[0]


def _steps(picture: NDArray[np.floating], axis: int, reach: float, edges: bool) -> F64:
    """(H, W - 1) for axis 2 or (H - 1, W) for axis 1: the factor exp(-sqrt(2) d / reach) by which a weight falls from a
    pixel to the next, at a distance d of 1 px, to which with `edges` a change of colour of EDGE adds `reach` px."""
    change = np.abs(np.diff(picture.astype(np.float64), axis=axis)).sum(axis=0)
    return np.ascontiguousarray(np.exp(-np.sqrt(2) / reach * (1 + edges * reach / EDGE * change)))
