"""Colour of a Gaussian seen from a direction: real spherical harmonics up to degree 3 in 3DGS order and sign.

The constants are sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!) times the polynomial's own factor (Sloan 2008, "Stupid Spherical
Harmonics Tricks", appendix A2); 3DGS keeps the Condon-Shortley sign and orders m = -l..l inside each band.
"""

from __future__ import annotations

import math

from .kernel_cache import kernel

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
def shade(harmonics, row, channel, degree, x, y, z):
    """max(0, 0.5 + sum of bands 0..degree) of one channel along the unit direction (x, y, z); NaN becomes 0."""
    value = 0.5 + C0 * harmonics[row, 0, channel]
    if degree > 0:
        value += C1 * (z * harmonics[row, 2, channel] - y * harmonics[row, 1, channel] - x * harmonics[row, 3, channel])
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        value += C2_XY * (
            x * y * harmonics[row, 4, channel] - y * z * harmonics[row, 5, channel] - x * z * harmonics[row, 7, channel]
        )
        value += C2_ZZ * (2.0 * zz - xx - yy) * harmonics[row, 6, channel]
        value += C2_XX * (xx - yy) * harmonics[row, 8, channel]
        if degree > 2:
            ring = 4.0 * zz - xx - yy
            value -= C3_3 * y * (3.0 * xx - yy) * harmonics[row, 9, channel]
            value += C3_2 * x * y * z * harmonics[row, 10, channel]
            value -= C3_1 * y * ring * harmonics[row, 11, channel]
            value += C3_0 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * harmonics[row, 12, channel]
            value -= C3_1 * x * ring * harmonics[row, 13, channel]
            value += C3_2Z * z * (xx - yy) * harmonics[row, 14, channel]
            value -= C3_3 * x * (xx - 3.0 * yy) * harmonics[row, 15, channel]
    if not value > 0.0:
        return 0.0
    return min(value, COLOUR_MAX)
