"""Spherical harmonics: the 3DGS basis term by term, orthonormality, and rotation by its defining property."""

import math

import numpy as np
import pytest

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.errors import GaussiansError
from gapmes.service.harmonics import C0, band_rotations, degree_of, evaluate_basis, rotate_harmonics

# Float64 rounding grows with the band: worst 9e-15 over the cases below; the specification asks for 1e-6.
ATOL = 1e-13


def unit(rng, count):
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_bands_0_to_3_are_the_polynomials_of_the_3dgs_format():
    x, y, z = (d := unit(np.random.default_rng(0), 64)).T
    root = lambda a: math.sqrt(a / math.pi)  # noqa: E731
    expected = [
        np.full_like(x, 0.5 * root(1)),
        -0.5 * root(3) * y,
        0.5 * root(3) * z,
        -0.5 * root(3) * x,
        0.5 * root(15) * x * y,
        -0.5 * root(15) * y * z,
        0.25 * root(5) * (2 * z * z - x * x - y * y),
        -0.5 * root(15) * x * z,
        0.25 * root(15) * (x * x - y * y),
        -0.25 * root(35 / 2) * y * (3 * x * x - y * y),
        0.5 * root(105) * x * y * z,
        -0.25 * root(21 / 2) * y * (4 * z * z - x * x - y * y),
        0.25 * root(7) * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.25 * root(21 / 2) * x * (4 * z * z - x * x - y * y),
        0.25 * root(105) * z * (x * x - y * y),
        -0.25 * root(35 / 2) * x * (x * x - 3 * y * y),
    ]
    np.testing.assert_allclose(evaluate_basis(d, 3), np.stack(expected, axis=1), atol=ATOL)
    assert pytest.approx(0.28209479177387814) == C0


def test_basis_is_orthonormal_on_the_sphere():
    nodes, weights = np.polynomial.legendre.leggauss(8)  # exact up to degree 15 in z
    phi = 2 * np.pi * np.arange(16) / 16
    z, p = (a.ravel() for a in np.meshgrid(nodes, phi, indexing="ij"))
    r = np.sqrt(1 - z * z)
    basis = evaluate_basis(np.stack([r * np.cos(p), r * np.sin(p), z], axis=1), 4)
    area = np.repeat(weights, 16) * 2 * np.pi / 16
    np.testing.assert_allclose(basis.T @ (basis * area[:, None]), np.eye(25), atol=ATOL)


@pytest.mark.case("A3")
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-6, 1e-3, 0.3, math.pi / 2, 2.0, math.pi - 1e-6, math.pi])
@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_rotated_then_evaluated_is_evaluated_at_the_rotated_direction(degree, angle):
    rng = np.random.default_rng(degree)
    for axis in [*np.eye(3), *unit(rng, 6)]:
        rotation = about_axis(axis, angle)
        coefficients = rng.normal(size=(5, (degree + 1) ** 2, 3))
        d = unit(rng, 40)
        before = np.einsum("dk,nkc->dnc", evaluate_basis(d, degree), coefficients)
        turned = rotate_harmonics(coefficients, rotation)
        after = np.einsum("dk,nkc->dnc", evaluate_basis(d @ rotation.T, degree), turned)
        np.testing.assert_allclose(after, before, atol=2e-13)


def test_rotations_form_a_group_of_orthogonal_matrices():
    rng = np.random.default_rng(3)
    a, b = about_axis(unit(rng, 1)[0], 1.1), about_axis(unit(rng, 1)[0], 2.9)
    for one, two, both in zip(band_rotations(a, 4), band_rotations(b, 4), band_rotations(a @ b, 4), strict=True):
        np.testing.assert_allclose(one @ two, both, atol=ATOL)
        np.testing.assert_allclose(one @ one.T, np.eye(len(one)), atol=ATOL)


@pytest.mark.case("A3")
def test_a_tiny_rotation_moves_the_coefficients_by_its_own_size():
    """The Euler-angle route loses all digits here; first order in the angle must survive."""
    generator = band_rotations(about_axis(np.array([0.0, 1.0, 0.0]), 1e-3), 4)
    tiny = band_rotations(about_axis(np.array([0.0, 1.0, 0.0]), 1e-9), 4)
    for coarse, fine in zip(generator[1:], tiny[1:], strict=True):
        eye = np.eye(len(fine))
        np.testing.assert_allclose((fine - fine.T) / 2e-9, (coarse - coarse.T) / 2e-3, atol=2e-5)
        np.testing.assert_allclose(np.diag(fine), np.diag(eye), atol=1e-12)


def test_other_counts_are_refused():
    with pytest.raises(GaussiansError, match="7 coefficients"):
        degree_of(7)
    with pytest.raises(GaussiansError):
        degree_of(36)
    with pytest.raises(GaussiansError, match="0 coefficients"):
        degree_of(0)
