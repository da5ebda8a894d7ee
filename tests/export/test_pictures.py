"""Comparing the pictures of two results: jumps are separated from smooth errors, have a limit of their own, and hide no
others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gapmes.export.cases import Case
from gapmes.export.compare import JUMP, jumped_rows
from gapmes.export.pictures import PictureAgreement, picture_agreement
from gapmes.export.samples import random_scene
from gapmes.export.tolerance import TOLERANCES, Precision
from gapmes.export.verification import picture_failures
from gapmes.service.network.contract import GAUSSIAN_OUTPUTS
from gapmes.service.pictures.picture_error import EQUAL_DB

SIDE = 32
COUNT = SIDE * SIDE
EVERY = np.ones(COUNT, dtype=bool)
Outputs = dict[str, NDArray[np.float32]]


@pytest.fixture
def case() -> Case:
    return Case("sample", "as trained", random_scene(2, SIDE, SIDE, seed=1))


@pytest.fixture
def reference(case: Case) -> Outputs:
    """A wall of Gaussians of random colours, five near depths in front of the first camera, wider than the picture."""
    random = np.random.default_rng(3)
    depth = 5 * float(case.inputs.near_far[0])
    steps = np.linspace(-1.5, 1.5, SIDE) * depth
    x, y = np.meshgrid(steps, steps)
    means = np.stack([x.ravel(), y.ravel(), np.full(COUNT, depth)], axis=1)
    quaternions = random.normal(size=(COUNT, 4))
    outputs = {
        "means": means,
        "scales": np.full((COUNT, 3), 0.06 * depth),
        "rotations_wxyz": quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        "opacities": np.full(COUNT, 0.9),
        "harmonics": random.normal(size=(COUNT, 1, 3)),
        "depth": np.full((2, SIDE, SIDE), depth),
    }
    return {name: value.astype(np.float32) for name, value in outputs.items()}


def changed(reference: Outputs, name: str, rows: slice, factor: float) -> Outputs:
    values = {key: value.copy() for key, value in reference.items()}
    values[name][rows] *= factor
    return values


def test_equal_results_agree_wholly(case: Case, reference: Outputs) -> None:
    assert picture_agreement(reference, reference, EVERY, case) == PictureAgreement(EQUAL_DB, EQUAL_DB, 0.0)


def test_gaussians_that_jump_are_replaced_in_the_second_picture(case: Case, reference: Outputs) -> None:
    values = changed(reference, "means", slice(500, 506), 0.5)
    found = picture_agreement(values, reference, EVERY, case)
    assert found.psnr < 50
    assert found.without_jumps == EQUAL_DB
    assert found.jumped == pytest.approx(6 / COUNT)


def test_what_a_changed_route_reaches_is_no_jump_and_stays(case: Case, reference: Outputs) -> None:
    values = changed(reference, "means", slice(500, 506), 0.5)
    untouched = EVERY.copy()
    untouched[500:504] = False
    found = picture_agreement(values, reference, untouched, case)
    assert found.jumped == pytest.approx(2 / (COUNT - 4))
    assert max(found.psnr, found.without_jumps) < 50
    everywhere = picture_agreement(values, reference, ~EVERY, case)
    assert everywhere == PictureAgreement(found.psnr, found.psnr, 0.0)


def test_an_error_below_a_jump_stays_in_both_pictures(case: Case, reference: Outputs) -> None:
    """The colour is wrong everywhere, by just too little to be a jump."""
    values = {key: value.copy() for key, value in reference.items()}
    values["harmonics"] += np.float32(0.9 * JUMP * np.abs(reference["harmonics"]).max())
    found = picture_agreement(values, reference, EVERY, case)
    assert found.jumped == 0
    assert found.without_jumps == found.psnr < 90


def test_the_sign_of_a_quaternion_is_no_jump(case: Case, reference: Outputs) -> None:
    values = changed(reference, "rotations_wxyz", slice(0, COUNT, 2), -1.0)
    assert picture_agreement(values, reference, EVERY, case) == PictureAgreement(EQUAL_DB, EQUAL_DB, 0.0)


@pytest.mark.parametrize("name", GAUSSIAN_OUTPUTS)
def test_every_output_of_a_gaussian_can_jump(name: str, reference: Outputs) -> None:
    values = changed(reference, name, slice(10, 12), 1.5)
    assert np.flatnonzero(jumped_rows(values, reference, GAUSSIAN_OUTPUTS)).tolist() == [10, 11]


def test_what_is_not_finite_jumped(reference: Outputs) -> None:
    values = changed(reference, "opacities", slice(7, 8), np.nan)
    assert np.flatnonzero(jumped_rows(values, reference, GAUSSIAN_OUTPUTS)).tolist() == [7]


@pytest.mark.parametrize(
    ("precision", "found", "named"),
    [
        ("fp32", PictureAgreement(51, 71, 0.009), []),
        ("fp32", PictureAgreement(49, 71, 0.009), ["picture: 49.0 dB, need 50"]),
        ("fp32", PictureAgreement(60, 69, 0.009), ["picture without jumps: 69.0 dB, need 70"]),
        ("fp32", PictureAgreement(60, 100, 0.011), ["1.10e-02 of the Gaussians jumped, allowed 1.0e-02"]),
        ("fp32", PictureAgreement(math.nan, math.nan, 0.0), ["picture: nan dB", "picture without jumps: nan dB"]),
        ("int8", PictureAgreement(41, 90, 0.9), []),
        ("int8", PictureAgreement(39, 90, 0.9), ["picture: 39.0 dB, need 40"]),
    ],
)
def test_limits_of_pictures(precision: Precision, found: PictureAgreement, named: list[str]) -> None:
    failures = picture_failures(found, TOLERANCES[precision])
    assert len(failures) == len(named)
    assert all(text in failure for text, failure in zip(named, failures, strict=True))
