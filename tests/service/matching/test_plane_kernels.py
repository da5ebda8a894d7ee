"""Loops over pixels against the same computation with slices and single sums."""

from __future__ import annotations

import numpy as np
import pytest
from guarded import Guarded, beside_nan

from gapmes.service.matching.plane_kernels import mean_planes, spread_along_rows, spread_down_columns
from gapmes.service.matching.plane_means import plane_means
from gapmes.service.matching.reprojection_kernels import compare_pixels
from gapmes.service.matching.window_match import window_mean
from gapmes.service.photographs.bilinear import bilinear

LIMIT = 0.4


@pytest.mark.parametrize("shape", [(2, 9, 14), (1, 1, 1), (1, 3, 40), (1, 40, 3), (3, 6, 5), (1, 8, 7)])
@pytest.mark.parametrize("radius", [0, 2, 3, 50])
def test_means_over_windows_that_the_border_cuts(shape: tuple[int, int, int], radius: int) -> None:
    planes = np.random.default_rng(1).normal(size=shape)
    found = np.full_like(planes, np.nan)
    mean_planes(planes, radius, found)
    for number, y, x in np.ndindex(shape):
        rows, columns = (slice(max(at - radius, 0), at + radius + 1) for at in (y, x))
        assert found[number, y, x] == pytest.approx(planes[number, rows, columns].mean(), abs=1e-12)


@pytest.mark.parametrize("shape", [(64, 48), (1, 33, 70), (2, 3, 9, 5), (6, 8), (7, 3), (1, 1)])
@pytest.mark.parametrize("radius", [0, 3, 9])
def test_means_are_those_of_numpy_to_the_bit(shape: tuple[int, ...], radius: int) -> None:
    """Before the network numpy makes them, after it the compiled loop: what they decide is the same."""
    planes = np.random.default_rng(6).normal(size=shape)
    means = plane_means(planes, radius)
    assert means.shape == shape
    assert (means == window_mean(planes, radius)).all()
    turned = np.asfortranarray(planes)
    turned.flags.writeable = False
    assert (plane_means(turned, radius) == means).all()


@pytest.mark.parametrize("row", range(9))
def test_a_row_that_is_no_number_spoils_its_windows_alone(row: int) -> None:
    """Rows are summed four at a time: none comes into another's sum. Down the columns what follows is spoiled too."""
    planes = np.random.default_rng(7).normal(size=(9, 12))
    planes[row] = np.nan
    assert np.array_equal(plane_means(planes), window_mean(planes), equal_nan=True)
    assert np.isfinite(plane_means(planes)[: max(row - 3, 0)]).all()


def test_features_are_compared_between_pixels_and_up_to_the_limit() -> None:
    """Against `bilinear` and a mean in float64; 3e-8 of 1 apart, the rounding of float32, found in most pixels."""
    rng = np.random.default_rng(2)
    own, others = (rng.random((height, 11, 5), dtype=np.float32) for height in (8, 7))
    column, row = rng.uniform(-3, 14, (8, 11)), rng.uniform(-3, 10, (8, 11))  # also beyond the border
    column[0, 0], row[0, 0] = 10.0, 6.0  # the last pixel itself
    seen = rng.random((8, 11)) < 0.8
    found = np.full((8, 11), np.nan)
    compare_pixels(own, others, column, row, seen.view(np.uint8), LIMIT, found)
    apart = np.abs(bilinear(others.astype(np.float64), column, row) - own).mean(axis=2)
    expected = np.where(seen, np.minimum(apart, LIMIT), LIMIT)
    assert np.abs(found - expected).max() < 3e-7
    assert 0.1 < (found[seen] == LIMIT).mean() < 0.9
    assert (found[~seen] == LIMIT).all()


def test_sums_along_lines_go_both_ways_and_stay_in_their_line() -> None:
    rng = np.random.default_rng(3)
    planes, weights = rng.normal(size=(2, 5, 8)), rng.random((5, 7))
    along, down = np.full_like(planes, np.nan), np.full((2, 8, 5), np.nan)
    spread_along_rows(planes, weights, along)
    for number, y, x in np.ndindex(planes.shape):
        total = sum(planes[number, y, other] * np.prod(weights[y, min(x, other) : max(x, other)]) for other in range(8))
        assert along[number, y, x] == pytest.approx(total, abs=1e-12)
    turned = np.ascontiguousarray(planes.transpose(0, 2, 1))
    spread_down_columns(turned, np.ascontiguousarray(weights.T), down)
    assert np.abs(down.transpose(0, 2, 1) - along).max() < 1e-12


def test_lines_of_one_pixel_are_their_own_sums() -> None:
    planes = np.random.default_rng(4).normal(size=(3, 1, 1))
    for spread, none in ((spread_along_rows, np.empty((1, 0))), (spread_down_columns, np.empty((0, 1)))):
        found = np.full_like(planes, np.nan)
        spread(planes, none, found)
        assert (found == planes).all()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 37), (37, 1), (17, 33)])
def test_nothing_is_read_or_written_beside_the_planes(height: int, width: int) -> None:
    """NaN stand beside what is read: one that came in would be found in the sums even with a weight of 0."""
    rng, guarded, shape = np.random.default_rng(5), Guarded(), (2, height, width)
    planes, steps = beside_nan(rng.random(shape)), rng.random((height, width))
    across, down = beside_nan(steps[:, 1:]), beside_nan(steps[1:])
    own, others = (beside_nan(rng.random((height, width, 5)).astype(np.float32)) for _ in range(2))
    column, row = (beside_nan(rng.choice([-9.0, 0.0, side - 1.0, 99.0], (height, width))) for side in (width, height))
    found = [guarded.array(shape, np.float64) for _ in range(3)]
    cost = guarded.array((height, width), np.float64)
    mean_planes(planes, 2, found[0])
    spread_along_rows(planes, across, found[1])
    spread_down_columns(planes, down, found[2])
    compare_pixels(own, others, column, row, np.ones((height, width), np.uint8), np.inf, cost)
    guarded.check()
    for array in (*found, cost):
        assert np.isfinite(array).all()
