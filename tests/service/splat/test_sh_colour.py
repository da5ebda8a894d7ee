"""Spherical harmonics: the reference basis is orthonormal, signed as in 3DGS, and the kernel evaluates the same."""

import numpy as np
import pytest

from gapmes.service.splat.prepare import BLOCK, FIELDS
from gapmes.service.splat.reference import sh_basis
from gapmes.service.splat.shade import shades


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


def colours(directions, harmonics, degree):
    """(N, 3) by the kernel, of Gaussians that lie in these directions from the camera, N at most a block."""
    count = len(directions)
    geometry, block = np.zeros((FIELDS, BLOCK)), np.zeros((*harmonics.shape[1:], BLOCK), np.float32)
    geometry[:3, :count] = directions.T + np.array([[1.0], [2.0], [3.0]])
    block[..., :count] = harmonics.transpose(1, 2, 0)
    view = np.array([*np.eye(3).ravel(), 1.0, 2.0, 3.0])
    out = np.empty(3 * BLOCK, np.float32)
    shades(geometry.ravel(), 0, block.ravel(), 0, degree, view, np.empty(16 * BLOCK), out)
    return out.reshape(3, BLOCK)[:, :count].T


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_kernel_evaluates_the_basis(degree):
    rng = np.random.default_rng(degree)
    directions = rng.standard_normal((50, 3))
    harmonics = rng.standard_normal((50, (degree + 1) ** 2, 3)).astype(np.float32)
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    expected = np.maximum(0.5 + np.einsum("nk,nkc->nc", sh_basis(units, degree), harmonics), 0.0)
    # computed in float64, rounded to float32 once: half a unit in the last place of values up to 8
    assert np.abs(colours(directions, harmonics, degree) - expected).max() < 8 * 2.0**-24


def test_fewer_bands_than_there_are_can_be_asked_for():
    rng = np.random.default_rng(7)
    directions, harmonics = rng.standard_normal((9, 3)), rng.standard_normal((9, 16, 3)).astype(np.float32)
    for degree in range(4):
        part = np.ascontiguousarray(harmonics[:, : (degree + 1) ** 2])
        assert np.array_equal(colours(directions, harmonics, degree), colours(directions, part, degree))


def test_colours_are_neither_negative_nor_unbounded_nor_nan():
    harmonics = np.array([-3e38, 3e38, np.nan], np.float32).reshape(1, 1, 3)
    assert colours(np.ones((1, 3)), harmonics, 0).tolist() == [[0.0, np.float32(1e37), 0.0]]
