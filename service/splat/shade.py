"""Colours of one block of Gaussians seen from a point: real spherical harmonics to degree 3 in 3DGS order and sign.

The constants are sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!) times the polynomial's own factor (Sloan 2008, "Stupid Spherical
Harmonics Tricks", appendix A2); 3DGS keeps the Condon-Shortley sign and orders m = -l..l inside each band.
"""

from __future__ import annotations

import math

import numpy as np

from .kernel_cache import kernel
from .prepare import BLOCK

C0 = math.sqrt(1 / (4 * math.pi))
C1 = math.sqrt(3 / (4 * math.pi))
C2_XY = math.sqrt(15 / (4 * math.pi))
C2_ZZ = math.sqrt(5 / (16 * math.pi))
C2_XX = math.sqrt(15 / (16 * math.pi))
C3_3 = math.sqrt(35 / (32 * math.pi))
C3_2 = math.sqrt(105 / (4 * math.pi))
C3_1 = math.sqrt(21 / (32 * math.pi))
C3_0 = math.sqrt(7 / (16 * math.pi))
C3_2Z = math.sqrt(105 / (16 * math.pi))

# Weights sum to at most 1, so a colour below this can never sum to infinity in float32.
COLOUR_MAX = 1e37


@kernel()
def shades(geometry, harmonics, degree, view, out):
    """Fill `out` (3 * BLOCK) channel by channel with max(0, 0.5 + sum of bands 0..degree); NaN becomes 0.

    harmonics (K, 3, BLOCK) float32; the direction is that from the camera's centre to the mean, of `geometry`.
    """
    flat, coefficients = geometry.reshape(-1), harmonics.reshape(-1)
    weights = np.empty(16 * BLOCK)
    if degree > 0:
        directions(flat, view, degree, weights)
    terms = (degree + 1) * (degree + 1)
    for channel in range(3):
        start = channel * BLOCK
        for j in range(BLOCK):
            weights[np.uint64(j)] = 0.5 + C0 * coefficients[np.uint64(start + j)]
        for term in range(1, terms):
            column = term * 3 * BLOCK + start
            for j in range(BLOCK):
                weights[np.uint64(j)] += weights[np.uint64(term * BLOCK + j)] * coefficients[np.uint64(column + j)]
        for j in range(BLOCK):
            value = weights[np.uint64(j)]
            out[np.uint64(start + j)] = np.float32(min(value, COLOUR_MAX)) if value > 0.0 else np.float32(0.0)


@kernel()
def directions(flat, view, degree, weights):
    """The basis functions 1..15 of each Gaussian's unit direction, term by term; row 0 stays free."""
    centre_x, centre_y, centre_z = view[9], view[10], view[11]
    for j in range(BLOCK):
        at = np.uint64(j)
        x, y = flat[at] - centre_x, flat[at + np.uint64(BLOCK)] - centre_y
        z = flat[at + np.uint64(2 * BLOCK)] - centre_z
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
        weights[at + np.uint64(BLOCK)] = -C1 * y
        weights[at + np.uint64(2 * BLOCK)] = C1 * z
        weights[at + np.uint64(3 * BLOCK)] = -C1 * x
        if degree > 1:
            xx, yy, zz = x * x, y * y, z * z
            weights[at + np.uint64(4 * BLOCK)] = C2_XY * x * y
            weights[at + np.uint64(5 * BLOCK)] = -C2_XY * y * z
            weights[at + np.uint64(6 * BLOCK)] = C2_ZZ * (2.0 * zz - xx - yy)
            weights[at + np.uint64(7 * BLOCK)] = -C2_XY * x * z
            weights[at + np.uint64(8 * BLOCK)] = C2_XX * (xx - yy)
            ring = 4.0 * zz - xx - yy
            weights[at + np.uint64(9 * BLOCK)] = -C3_3 * y * (3.0 * xx - yy)
            weights[at + np.uint64(10 * BLOCK)] = C3_2 * x * y * z
            weights[at + np.uint64(11 * BLOCK)] = -C3_1 * y * ring
            weights[at + np.uint64(12 * BLOCK)] = C3_0 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)
            weights[at + np.uint64(13 * BLOCK)] = -C3_1 * x * ring
            weights[at + np.uint64(14 * BLOCK)] = C3_2Z * z * (xx - yy)
            weights[at + np.uint64(15 * BLOCK)] = -C3_3 * x * (xx - 3.0 * yy)
