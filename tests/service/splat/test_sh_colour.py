"""Spherical harmonics: the reference basis is orthonormal, signed as in 3DGS, and the kernel evaluates the same."""

import numpy as np
import pytest

from gapmes.service.splat.reference import sh_basis
from gapmes.service.splat.shade import shade


def test_the_basis_is_orthonormal_on_the_sphere():
    """Gauss-Legendre in z times equal steps in azimuth integrates degree 6 polynomials exactly."""
    z, weight = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * np.pi * (np.arange(16) + 0.5) / 16
    zz, aa = (grid.ravel() for grid in np.meshgrid(z, azimuth, indexing="ij"))
    ring = np.sqrt(1 - zz**2)
    basis = sh_basis(np.stack([ring * np.cos(aa), ring * np.sin(aa), zz], axis=1), 3)
    weights = np.repeat(weight, 16) * 2 * np.pi / 16
    assert np.abs(basis.T * weights @ basis - np.eye(16)).max() < 1e-13


@pytest.mark.parametrize(
    ("index", "direction", "value"),
    [
        (0, (0, 0, 1), 0.28209479177387814),
        (1, (0, 1, 0), -0.4886025119029199),
        (2, (0, 0, 1), 0.4886025119029199),
        (3, (1, 0, 0), -0.4886025119029199),
        (4, (0.6, 0.8, 0), 1.0925484305920792 * 0.48),
        (5, (0, 0.6, 0.8), -1.0925484305920792 * 0.48),
        (6, (0, 0, 1), 0.31539156525252005 * 2),
        (9, (0, 1, 0), 0.5900435899266435),
        (15, (1, 0, 0), -0.5900435899266435),
    ],
)
def test_order_and_sign_are_those_of_3dgs(index, direction, value):
    assert sh_basis(np.array([direction], float), 3)[0, index] == pytest.approx(value, abs=1e-14)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_kernel_evaluates_the_basis(degree):
    rng = np.random.default_rng(degree)
    directions = rng.standard_normal((50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    harmonics = rng.standard_normal((50, (degree + 1) ** 2, 3)).astype(np.float32)
    expected = np.maximum(0.5 + np.einsum("nk,nkc->nc", sh_basis(directions, degree), harmonics), 0.0)
    ours = [[shade(harmonics, i, c, degree, *directions[i]) for c in range(3)] for i in range(50)]
    assert np.abs(ours - expected).max() < 1e-14 * 16


def test_colours_are_neither_negative_nor_unbounded_nor_nan():
    harmonics = np.array([-3e38, 3e38, np.nan], np.float32).reshape(1, 1, 3)
    assert shade(harmonics, 0, 0, 0, 0.0, 0.0, 1.0) == 0.0
    assert shade(harmonics, 0, 1, 0, 0.0, 0.0, 1.0) == 1e37
    assert shade(harmonics, 0, 2, 0, 0.0, 0.0, 1.0) == 0.0
