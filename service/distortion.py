"""How far the coefficients of a lens model move a picture's points away from where a pinhole has them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .camera import Camera

COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_GRID = 33  # points per side, the borders among them


def largest_shift(camera: Camera, coefficients: Mapping[str, float]) -> float:
    """The largest distance in px between a point with and without distortion, over the picture and its border.

    With x, y the ray's slopes and r^2 = x^2 + y^2, the model of OpenCV (calib3d) has x (1 + k1 r^2 + k2 r^4 + k3 r^6) /
    (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and y alike with p1 and p2 exchanged. Without k5 and
    k6, k4 is the factor of r^8 instead, as nerfstudio has it. Infinite where the model breaks down.
    """
    k1, k2, k3, k4, k5, k6, p1, p2 = (coefficients.get(name, 0.0) for name in COEFFICIENTS)
    across = (np.linspace(0.0, camera.width, _GRID) - camera.cx) / camera.fx
    down = (np.linspace(0.0, camera.height, _GRID) - camera.cy) / camera.fy
    x, y = np.meshgrid(across, down)
    r2 = x * x + y * y
    with np.errstate(all="ignore"):  # absurd coefficients overflow, which the caller hears as infinity
        radial = r2 * (k1 + r2 * (k2 + r2 * k3))
        if k5 or k6:
            below = r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = (radial - below) / (1.0 + below)
        else:
            radial = radial + k4 * r2**4
        dx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        dy = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)
        shift = np.hypot(camera.fx * dx, camera.fy * dy)
    return float(np.where(np.isfinite(shift), shift, np.inf).max())
