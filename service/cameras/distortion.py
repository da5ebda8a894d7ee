"""Lens distortion: the model, its inverse, how far it moves points, and the pinhole a photograph is resampled to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import IntrinsicsError

F64 = NDArray[np.float64]

MAX_SHIFT_PX = 0.5  # up to which distortion is ignored: two views together are then at most a pixel off
MIN_KEPT = 0.5  # share of the photograph's pixels inside the pinhole's picture; below it a pinhole is the wrong model
_GRID = 33  # points per side, the borders among them
_STEPS = 16  # continuation steps from the principal point to the target, each solved by Newton's method
_NEWTON = 8  # iterations; it converges quadratically
_CONVERGED = 1e-9  # slopes: 1e-6 px at f = 1000 px


@dataclass(frozen=True)
class Lens:
    """Intrinsics in px and distortion coefficients, in OpenCV's rational model.

    With x, y the normalised coordinates of a ray and r^2 = x^2 + y^2, the distorted ones are (OpenCV, calib3d)

        x (1 + k1 r^2 + k2 r^4 + k3 r^6 + r8 r^8) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)

    and likewise for y with p1 and p2 exchanged. r8 is nerfstudio's fourth radial coefficient; OpenCV has none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    r8: float = 0.0

    def distorted(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Distorted normalised coordinates of the undistorted `x`, `y`, all of one shape."""
        r2 = x * x + y * y
        factor = _polynomial(r2, self._numerator) / _polynomial(r2, self._denominator)
        return (
            x * factor + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * factor + 2.0 * self.p2 * x * y + self.p1 * (r2 + 2.0 * y * y),
        )

    def undistorted(self, x_distorted: F64, y_distorted: F64) -> tuple[F64, F64]:
        """The inverse of `distorted`; NaN where the model folds between the principal point and the point.

        Newton's method with continuation along the line from the principal point, which stays on the branch that starts
        there. A Jacobian that is not positive definite marks a fold.
        """
        x, y = np.zeros_like(x_distorted), np.zeros_like(y_distorted)
        sound = np.ones(np.shape(x_distorted), dtype=np.bool_)
        with np.errstate(all="ignore"):  # absurd coefficients overflow; such points are not sound
            for step in range(1, _STEPS + 1):
                to_x, to_y = x_distorted * (step / _STEPS), y_distorted * (step / _STEPS)
                for _ in range(_NEWTON):
                    (xx, xy, yx, yy), (at_x, at_y) = self._jacobian(x, y), self.distorted(x, y)
                    det = xx * yy - xy * yx
                    miss_x, miss_y = at_x - to_x, at_y - to_y
                    x = x - (yy * miss_x - xy * miss_y) / det
                    y = y - (xx * miss_y - yx * miss_x) / det
                (xx, xy, yx, yy), (at_x, at_y) = self._jacobian(x, y), self.distorted(x, y)
                found = np.hypot(at_x - to_x, at_y - to_y) <= _CONVERGED
                positive = (xx * yy - xy * yx > 0) & (xx + yy > 0)
                sound &= found & positive & (_polynomial(x * x + y * y, self._denominator) > 0)
        return np.where(sound, x, np.nan), np.where(sound, y, np.nan)

    def largest_shift(self) -> float:
        """The largest displacement by distortion in px, over a grid that includes the border; inf on overflow."""
        across = (np.linspace(0.0, self.width, _GRID) - self.cx) / self.fx
        down = (np.linspace(0.0, self.height, _GRID) - self.cy) / self.fy
        x, y = np.meshgrid(across, down)
        with np.errstate(all="ignore"):  # absurd coefficients overflow
            to_x, to_y = self.distorted(x, y)
            shift = np.hypot(self.fx * (to_x - x), self.fy * (to_y - y))
        return float(np.where(np.isfinite(shift), shift, np.inf).max())

    @property
    def _numerator(self) -> tuple[float, ...]:
        return 1.0, self.k1, self.k2, self.k3, self.r8

    @property
    def _denominator(self) -> tuple[float, ...]:
        return 1.0, self.k4, self.k5, self.k6

    def _jacobian(self, x: F64, y: F64) -> tuple[F64, F64, F64, F64]:
        """Derivatives of `distorted`: of x by x and y, of y by x and y."""
        r2 = x * x + y * y
        above, below = _polynomial(r2, self._numerator), _polynomial(r2, self._denominator)
        factor = above / below
        slope = (_derivative(r2, self._numerator) - factor * _derivative(r2, self._denominator)) / below
        both = 2.0 * x * y * slope
        return (
            factor + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            both + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            both + 2.0 * self.p2 * y + 2.0 * self.p1 * x,
            factor + 2.0 * y * y * slope + 2.0 * self.p2 * x + 6.0 * self.p1 * y,
        )


@dataclass(frozen=True)
class PinholeWindow:
    """The rectangle that an undistorted photograph fills, in px of a pinhole with the lens's own intrinsics."""

    left: int  # px; negative where the photograph shows more than the pinhole of its size would
    top: int
    width: int
    height: int
    kept_share: float  # of the photograph's pixels


@lru_cache(maxsize=256)
def pinhole_window(lens: Lens) -> PinholeWindow:
    """The largest rectangle of whole pixels inside all four undistorted sides of the photograph, so that each of its
    pixels has a colour: its left edge is the rightmost point of the undistorted left side, and so on.

    Raises `IntrinsicsError` where the model folds inside the picture, or less than half of the pixels would be kept.
    """
    cure = "solve for fewer coefficients, or undistort the photographs first, for example with colmap image_undistorter"
    x, y = _sides(0.0, 0.0, lens.width, lens.height)
    x, y = lens.undistorted((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise IntrinsicsError("the lens model folds the picture over inside its border", cure=cure)
    x, y = x * lens.fx + lens.cx, y * lens.fy + lens.cy
    left, right, top, bottom = np.ceil(x[0].max()), np.floor(x[1].min()), np.ceil(y[2].max()), np.floor(y[3].min())
    kept = 0.0
    if left < right and top < bottom:
        x, y = _sides(left, top, right, bottom)
        x, y = lens.distorted((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy)
        outline_x, outline_y = (np.concatenate([at[2], at[1], at[3, ::-1], at[0, ::-1]]) for at in (x, y))
        area = 0.5 * abs(np.sum(outline_x * np.roll(outline_y, -1) - outline_y * np.roll(outline_x, -1)))
        kept = float(area * lens.fx * lens.fy / (lens.width * lens.height))
    if not kept >= MIN_KEPT:
        raise IntrinsicsError(
            f"a pinhole holds {kept:.0%} of the photograph's pixels, need {MIN_KEPT:.0%}: the lens bends too much",
            cure=cure,
        )
    return PinholeWindow(int(left), int(top), int(right - left), int(bottom - top), min(kept, 1.0))


def _sides(left: float, top: float, right: float, bottom: float) -> tuple[F64, F64]:
    """(4, N) x and (4, N) y of points along the left, right, upper and lower side, corners included."""
    across, down = np.linspace(left, right, 2 * _GRID - 1), np.linspace(top, bottom, 2 * _GRID - 1)
    x = np.stack([np.full_like(down, left), np.full_like(down, right), across, across])
    y = np.stack([down, down, np.full_like(across, top), np.full_like(across, bottom)])
    return x, y


def _polynomial(r2: F64, coefficients: tuple[float, ...]) -> F64:
    value = np.zeros_like(r2)
    for coefficient in reversed(coefficients):
        value = value * r2 + coefficient
    return value


def _derivative(r2: F64, coefficients: tuple[float, ...]) -> F64:
    return _polynomial(r2, tuple(power * value for power, value in enumerate(coefficients))[1:])
