"""Real spherical harmonics in the 3DGS order and sign: evaluate them and rotate their coefficients, in float64.

Band l holds 2l + 1 coefficients, m = -l..l. The sign is the standard real basis times (-1)^m, which makes band 1
(-C1 y, C1 z, -C1 x) with C1 = sqrt(3 / 4 pi), as the 3DGS format has it.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import GaussiansError

F64 = NDArray[np.float64]

MAX_DEGREE = 4
C0 = 0.5 / math.sqrt(math.pi)  # the constant basis function; colour = 0.5 + C0 * f_dc
BAND_1_AXES = (1, 2, 0)  # m = -1, 0, 1 go with y, z, x


def degree_of(count: int) -> int:
    """Degree of `count` = (degree + 1)^2 coefficients. Raises `GaussiansError` for any other count."""
    degree = math.isqrt(count) - 1
    if count < 1 or (degree + 1) ** 2 != count or degree > MAX_DEGREE:
        raise GaussiansError(f"{count} coefficients per channel, need 1, 4, 9, 16 or 25", field="harmonics")
    return degree


def evaluate_basis(directions: F64, degree: int) -> F64:
    """(N, (degree + 1)^2) basis functions at unit `directions` (N, 3)."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    return np.stack(basis_functions(x, y, z, degree), axis=1)


def basis_functions(x: Any, y: Any, z: Any, degree: int) -> list[Any]:
    """The (degree + 1)^2 basis functions in order at unit directions; for arrays or tensors of any one shape.

    Y_lm = K_lm P_lm(z) Re|Im (x + iy)^|m|, P_lm the associated Legendre function without its (1 - z^2)^(m/2) factor,
    by the three-term recurrence in l (DLMF 14.10.3).
    """
    zero = 0 * x
    basis: list[Any] = [zero] * (degree + 1) ** 2
    real, imaginary = zero + 1, zero
    diagonal = 1.0
    for m in range(degree + 1):
        if m > 0:
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
            diagonal *= 2 * m - 1
        before, legendre = zero, zero + diagonal
        for band in range(m, degree + 1):
            if band > m:
                following = ((2 * band - 1) * z * legendre - (band + m - 1) * before) / (band - m)
                before, legendre = legendre, following
            ratio = math.factorial(band - m) / math.factorial(band + m)
            norm = (-1) ** m * math.sqrt((2 * band + 1) / (4 * math.pi) * ratio * (2 if m else 1))
            basis[band * band + band + m] = norm * legendre * real
            if m > 0:
                basis[band * band + band - m] = norm * legendre * imaginary
    return basis


def rotate_harmonics(coefficients: NDArray, rotation: F64) -> F64:
    """(N, K, C) coefficients of the turned functions: their value at `rotation @ d` is the old one at d."""
    coefficients = np.asarray(coefficients, dtype=np.float64)
    degree = degree_of(coefficients.shape[1])
    turned = np.empty_like(coefficients)
    for band, matrix in enumerate(band_rotations(rotation, degree)):
        rows = slice(band * band, (band + 1) ** 2)
        turned[:, rows] = np.einsum("mn,inc->imc", matrix, coefficients[:, rows])
    return turned


def band_rotations(rotation: F64, degree: int) -> list[F64]:
    """Per band the (2l + 1, 2l + 1) matrix that turns its coefficients, for a proper rotation (3, 3).

    Recursion of Ivanic and Ruedenberg (J. Phys. Chem. 100, 6342, 1996, with the erratum of 102, 9099, 1998): every
    entry of band l is a sum of at most six products of band 1 and band l - 1, so that no angle is ever formed and a
    tiny rotation loses no digits.
    """
    rotation = np.asarray(rotation, dtype=np.float64)
    first = rotation[np.ix_(BAND_1_AXES, BAND_1_AXES)]
    bands = [np.ones((1, 1)), first]
    for band in range(2, degree + 1):
        bands.append(next_band(first, bands[-1], band))
    signs = [np.array([(-1.0) ** m for m in range(-band, band + 1)]) for band in range(degree + 1)]
    return [sign[:, None] * matrix * sign for sign, matrix in zip(signs, bands[: degree + 1], strict=True)]


def next_band(first: F64, previous: F64, band: int) -> F64:
    """Band l from bands 1 and l - 1 (their indices are shifted by +1 and +(l - 1)); entries may be any numbers."""

    def p(i: int, mu: int, n: int) -> float:
        row = previous[mu + band - 1]
        if n == band:
            return first[i + 1, 2] * row[-1] - first[i + 1, 0] * row[0]
        if n == -band:
            return first[i + 1, 2] * row[0] + first[i + 1, 0] * row[-1]
        return first[i + 1, 1] * row[n + band - 1]

    def p_v(m: int, n: int) -> float:
        if m == 0:
            return p(1, 1, n) + p(-1, -1, n)
        if m > 0:
            one = m == 1
            return p(1, m - 1, n) * math.sqrt(2 if one else 1) - (0.0 if one else p(-1, 1 - m, n))
        one = m == -1
        return (0.0 if one else p(1, m + 1, n)) + p(-1, -m - 1, n) * math.sqrt(2 if one else 1)

    def p_w(m: int, n: int) -> float:
        if m > 0:
            return p(1, m + 1, n) + p(-1, -m - 1, n)
        return p(1, m - 1, n) - p(-1, 1 - m, n)

    out = np.empty((2 * band + 1, 2 * band + 1), dtype=first.dtype)
    for m in range(-band, band + 1):
        for n in range(-band, band + 1):
            u, v, w = _weights(band, m, n)
            value = u * p(0, m, n) if u else 0.0
            value += v * p_v(m, n) if v else 0.0
            value += w * p_w(m, n) if w else 0.0
            out[m + band, n + band] = value
    return out


@cache
def _weights(band: int, m: int, n: int) -> tuple[float, float, float]:
    """u, v, w of the recursion (table 1 of the paper, erratum applied)."""
    zero = 1 if m == 0 else 0
    size = abs(m)
    d = (band + n) * (band - n) if abs(n) < band else 2 * band * (2 * band - 1)
    u = math.sqrt((band + m) * (band - m) / d)
    v = 0.5 * math.sqrt((1 + zero) * (band + size - 1) * (band + size) / d) * (1 - 2 * zero)
    w = -0.5 * math.sqrt((band - size - 1) * (band - size) / d) * (1 - zero) if size < band else 0.0
    return u, v, w
