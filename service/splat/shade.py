"""Colours of one block of Gaussians seen from a point: real spherical harmonics to degree 3 in 3DGS order and sign.

The constants are sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!) times the polynomial's own factor (Sloan 2008, "Stupid Spherical
Harmonics Tricks", appendix A2); 3DGS keeps the Condon-Shortley sign and orders m = -l..l inside each band.
"""

from __future__ import annotations

import math

from .access import BLOCK, get, get_field, put, put_field, smaller
from .kernel_cache import kernel
from .prepare import MEAN

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
def shades(geometry, at, harmonics, start, degree, view, weights, out):
    """Fill `out` (3, BLOCK) with the colours max(0, 0.5 + sum of bands 0..degree), at most COLOUR_MAX; NaN becomes 0.

    The block's fields begin at geometry[at], its coefficients (K, 3, BLOCK) at harmonics[start]; the direction is that
    from the camera centre to the mean. weights (16 * BLOCK,) is a buffer.
    """
    if degree > 0:
        directions(geometry, at, view, degree, weights)
    terms = (degree + 1) * (degree + 1)
    for channel in range(3):
        for j in range(BLOCK):
            put(weights, j, 0.5 + C0 * get_field(harmonics, start + j, channel))
        for term in range(1, terms):
            row = 3 * term + channel
            for j in range(BLOCK):
                more = get_field(weights, j, term) * get_field(harmonics, start + j, row)
                put(weights, j, get(weights, j) + more)
        for j in range(BLOCK):
            value = get(weights, j)
            put_field(out, j, channel, smaller(value, COLOUR_MAX) if value > 0.0 else 0.0)


@kernel()
def directions(geometry, start, view, degree, weights):
    """Fill rows 1 up to 15 of `weights` (16, BLOCK) with the basis functions of each Gaussian's unit direction."""
    centre_x, centre_y, centre_z = get(view, 9), get(view, 10), get(view, 11)
    for j in range(BLOCK):
        at = start + j
        x, y = get_field(geometry, at, MEAN) - centre_x, get_field(geometry, at, MEAN + 1) - centre_y
        z = get_field(geometry, at, MEAN + 2) - centre_z
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
        put_field(weights, j, 1, -C1 * y)
        put_field(weights, j, 2, C1 * z)
        put_field(weights, j, 3, -C1 * x)
        if degree > 1:
            xx, yy, zz = x * x, y * y, z * z
            put_field(weights, j, 4, C2_XY * x * y)
            put_field(weights, j, 5, -C2_XY * y * z)
            put_field(weights, j, 6, C2_ZZ * (2.0 * zz - xx - yy))
            put_field(weights, j, 7, -C2_XY * x * z)
            put_field(weights, j, 8, C2_XX * (xx - yy))
            ring = 4.0 * zz - xx - yy
            put_field(weights, j, 9, -C3_3 * y * (3.0 * xx - yy))
            put_field(weights, j, 10, C3_2 * x * y * z)
            put_field(weights, j, 11, -C3_1 * y * ring)
            put_field(weights, j, 12, C3_0 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy))
            put_field(weights, j, 13, -C3_1 * x * ring)
            put_field(weights, j, 14, C3_2Z * z * (xx - yy))
            put_field(weights, j, 15, -C3_3 * x * (xx - 3.0 * yy))
