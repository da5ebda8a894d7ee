"""The comparison itself: known errors come out as the numbers they are, and shapes are not broadcast."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.export.compare import ambiguous_routes, deviation, quaternions_aligned, route_agreement


def test_deviation_of_known_errors() -> None:
    reference = np.linspace(-2, 2, 1000)
    value = reference.copy()
    value[:5] += 0.4
    found = deviation(value, reference)
    assert found.maximum == pytest.approx(0.2)
    assert found.p99 == pytest.approx(0.0)
    assert found.mean == pytest.approx(0.2 * 5 / 1000)
    assert found.jumps == pytest.approx(0.005)
    assert found.scale == 2
    assert found.finite


def test_not_finite_values_are_an_infinite_error() -> None:
    found = deviation(np.array([1.0, np.nan]), np.array([1.0, 2.0]))
    assert not found.finite
    assert found.maximum == np.inf


def test_a_shape_that_would_broadcast_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape is \(1, 3\), need \(2, 3\)"):
        deviation(np.zeros((1, 3)), np.zeros((2, 3)))


def test_opposite_quaternions_are_the_same_rotation() -> None:
    q = np.array([[0.5, 0.5, -0.5, 0.5], [1.0, 0, 0, 0]])
    assert np.array_equal(quaternions_aligned(-q, q), q)


def test_ambiguity_follows_the_deciding_gaps_only() -> None:
    task = np.array([[1.0, 0, 0, 0]] * 4)
    expert = np.array(
        [
            [3.0, 2.0, 1.0],  # clear
            [3.0, 2.0, 2.0 - 1e-6],  # second and third decide who is in
            [3.0, 3.0 - 1e-6, 1.0],  # first and second decide the hard choice
            [3.0, 2.0, 1.0],
        ]
    )
    assert ambiguous_routes(expert, task, 2).tolist() == [False, True, True, False]
    assert ambiguous_routes(expert, np.array([[1.0, 1.0, 0, 0]] * 4), 2).all()
    assert ambiguous_routes(expert, task, 1).tolist() == [False, False, True, False]


def test_route_agreement_counts_kept_patches() -> None:
    index = np.array([[[0, 1], [2, 3], [4, 5]]])
    other = np.array([[[0, 1], [3, 2], [4, 0]]])
    tasks = np.tile(np.array([1.0, 0, 0, 0]), (1, 3, 1))
    kept, ambiguous = np.array([[True, True, False]]), np.array([False, True, False])
    found = route_agreement(index, other, tasks, tasks, ambiguous, kept)
    assert (found.patches, found.flipped, found.flipped_unambiguous) == (2, 1, 0)
