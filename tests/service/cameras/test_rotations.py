"""Rotations: group axioms, matrix against quaternion near 180 degrees, slerp and mean."""

import math

import numpy as np
import pytest

from gapmes.service.cameras.rotations import (
    about_axis,
    matrix_from_quaternion,
    mean_rotation,
    quaternion_from_matrix,
    quaternion_from_vector,
    quaternion_product,
    rotated,
    rotation_angle,
    rotation_vector,
    slerp,
)

ANGLES = [0.0, 1e-12, 1e-6, 0.5, math.pi / 2, 3.0, math.pi - 1e-6, math.pi - 1e-12, math.pi]


def axes(seed=0, count=8):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return [*np.eye(3), *(d / np.linalg.norm(d, axis=1, keepdims=True))]


@pytest.mark.case("A4")
@pytest.mark.parametrize("angle", ANGLES)
def test_matrix_to_quaternion_and_back(angle):
    for axis in axes():
        rotation = about_axis(axis, angle)
        q = quaternion_from_matrix(rotation)
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
        np.testing.assert_allclose(matrix_from_quaternion(q), rotation, atol=2e-15)
        assert rotation_angle(rotation) == pytest.approx(angle, abs=1e-14 if angle < 3 else 1e-7)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_vectors_are_axis_times_angle_and_back(angle):
    for axis in axes():
        q = quaternion_from_vector(angle * axis)
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
        np.testing.assert_allclose(matrix_from_quaternion(q), about_axis(axis, angle), atol=2e-15)
        found = rotation_vector(about_axis(axis, angle))
        if angle > math.pi - 1e-9:  # either end of the axis
            found = found * np.sign(found @ axis)
        np.testing.assert_allclose(found, angle * axis, atol=1e-14)
    batch = np.stack([angle * axis for axis in axes()])
    np.testing.assert_array_equal(quaternion_from_vector(batch), [quaternion_from_vector(one) for one in batch])


def test_product_is_the_matrix_product_and_conjugation_inverts():
    for first, second in zip(axes(1), axes(2), strict=True):
        a, b = about_axis(first, 0.7), about_axis(second, 2.6)
        product = quaternion_product(quaternion_from_matrix(a), quaternion_from_matrix(b))
        np.testing.assert_allclose(matrix_from_quaternion(product), a @ b, atol=2e-15)
        q = quaternion_from_matrix(a)
        np.testing.assert_allclose(quaternion_product(q, q * [1, -1, -1, -1]), [1, 0, 0, 0], atol=1e-15)


def test_rotation_about_z_is_right_handed():
    np.testing.assert_allclose(about_axis(np.array([0.0, 0, 1]), math.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_slerp_has_constant_speed_and_hits_its_ends():
    start = about_axis(axes()[4], 0.4)
    step = about_axis(axes()[5], 1.2)
    for fraction in (0.0, 0.25, 0.5, 1.0):
        expected = start @ about_axis(axes()[5], 1.2 * fraction)
        np.testing.assert_allclose(slerp(start, start @ step, fraction), expected, atol=1e-14)
    np.testing.assert_array_equal(slerp(start, start, 0.3), start)


def test_mean_rotation_lies_between():
    axis = axes()[6]
    mean = mean_rotation(np.stack([about_axis(axis, a) for a in (-0.3, 0.1, 0.2)]))
    np.testing.assert_allclose(np.linalg.det(mean), 1, atol=1e-14)
    np.testing.assert_allclose(
        mean,
        about_axis(
            axis,
            math.atan2(math.sin(-0.3) + math.sin(0.1) + math.sin(0.2), math.cos(0.3) + math.cos(0.1) + math.cos(0.2)),
        ),
        atol=1e-14,
    )


def test_turned_vectors_are_those_of_the_matrix_product():
    """Any shape, float32 as well; a hundred thousand at once give the same bits as one by one. Measured: 1e-15."""
    rotation = matrix_from_quaternion(np.array([0.5, -0.5, 0.1, 0.7]))
    vectors = np.random.default_rng(5).normal(size=(100_000, 3)).astype(np.float32)
    found = rotated(rotation, vectors)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, vectors.astype(np.float64) @ rotation.T, rtol=0, atol=5e-15)
    np.testing.assert_array_equal(rotated(rotation, vectors[7]), found[7])
    np.testing.assert_array_equal(rotated(rotation, vectors.reshape(10, -1, 3)), found.reshape(10, -1, 3))
