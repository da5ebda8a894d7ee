"""The comparison itself: known errors give the right numbers, and shapes are not broadcast."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.export.compare import deviation, image_units, quaternions_aligned
from gapmes.export.routes import agreement, ambiguous, flipped_patches, untouched


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


def test_masked_rows_do_not_count() -> None:
    reference = np.ones((4, 3))
    value = reference.copy()
    value[2] += 100
    found = deviation(value, reference, np.array([True, True, False, True]))
    assert (found.maximum, found.p99, found.jumps) == (0, 0, 0)


def test_what_is_not_compared_is_not_near() -> None:
    found = deviation(np.ones((4, 3)), np.ones((4, 3)), np.zeros(4, dtype=bool))
    assert found.finite
    assert (found.maximum, found.p99, found.mean, found.jumps) == (np.inf, np.inf, np.inf, 1)


def test_a_reference_that_is_not_finite_never_passes() -> None:
    found = deviation(np.zeros(10_000), np.where(np.arange(10_000) == 7, np.nan, 0.0))
    assert not found.finite
    assert found.p99 == np.inf


def test_image_units_weigh_the_foreground() -> None:
    outputs = {
        "means": np.array([[0.0, 0, 2.0], [0, 0, 1000.0]]),
        "scales": np.array([[0.02, 0.02, 0.02], [10.0, 10, 10]]),
        "depth": np.array([2.0, 1000.0]),
    }
    changed = image_units(outputs, near=1.0)
    np.testing.assert_allclose(changed["means"], [[0, 0, 0.5], [0, 0, 0.001]])
    np.testing.assert_allclose(changed["scales"], 0.01)
    np.testing.assert_allclose(changed["depth"], [0.5, 0.001])


def test_ambiguity_follows_the_deciding_gaps_only() -> None:
    logits = np.array(
        [
            [3.0, 2.0, 1.0],  # clear
            [3.0, 2.0, 2.0 - 1e-6],  # second and third decide who is in
            [3.0, 3.0 - 1e-6, 1.0],  # first and second decide the hard choice
        ]
    )
    assert ambiguous(logits, 2).tolist() == [False, True, True]
    assert ambiguous(logits, 1).tolist() == [False, False, True]


def test_flips_are_counted_for_kept_patches_and_split_by_what_decides() -> None:
    reference = {"expert_index": np.array([[[0, 1], [2, 3], [4, 5]]]), "task_weight": np.eye(4)[None, :3]}
    values = {"expert_index": np.array([[[0, 1], [3, 2], [4, 0]]]), "task_weight": np.eye(4)[None, :3]}
    kept = np.array([[True, True, False]])
    flipped = flipped_patches(values, reference, kept)
    assert flipped.tolist() == [[False, True, False]]
    found = agreement(flipped, np.array([[False, True, False]]), kept)
    assert (found.patches, found.flipped, found.flipped_unambiguous) == (2, 1, 0)
    values["task_weight"] = np.eye(4)[None, [1, 1, 2]]
    assert flipped_patches(values, reference, kept).tolist() == [[True, True, False]]


def test_a_flipped_patch_excuses_itself_and_its_neighbours_and_nothing_else() -> None:
    flipped = np.zeros((2, 16), dtype=bool)
    flipped[1, 0] = True  # upper left corner of the second view, 4 x 4 patches
    free = untouched(flipped, 64, 64, 2 * 64 * 64 + 2 * 12 * 12)
    assert free["patch"].sum() == 31
    assert free["pixel"][0].all()
    assert not free["pixel"][1, :32, :32].any()
    assert free["pixel"][1, 32:].all()
    cells = free["gaussian"][2 * 64 * 64 :].reshape(2, 12, 12)
    assert cells[0].all()
    assert not cells[1, :6, :6].any()  # 32 px are 4 cells, and 2 of margin
    assert cells[1, 6:].all()
