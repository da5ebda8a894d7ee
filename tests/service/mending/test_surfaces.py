"""Planes through confirmed pixels against their definition, and the figures that describe them."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.mending.surfaces import EDGE, LEAST, RIDGE, _steps, _weighted_sums, described_surface, surface

SIDE = 64
FLAT = np.full((3, SIDE, SIDE), 0.5, np.float32)


def test_a_plane_is_found_from_a_few_of_its_pixels() -> None:
    """Inverse depth is linear in the position."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    inverse = 0.5 + 0.2 * x - 0.1 * y
    sure = np.random.default_rng(5).random((SIDE, SIDE)) < 0.3
    found = surface(FLAT, np.where(sure, inverse, 0.35 + 0.4 * (x > 0.5)), sure, 6.0)
    assert np.abs(found.inverse - inverse)[8:-8, 8:-8].max() < 1e-3  # found: 1.3e-4: the ridge's share of the slope


def test_an_edge_keeps_surfaces_apart() -> None:
    left = np.arange(SIDE) < SIDE // 2
    image = np.broadcast_to(np.where(left, 0.2, 0.8).astype(np.float32), (3, SIDE, SIDE))
    inverse = np.broadcast_to(np.where(left, 1.0, 0.5), (SIDE, SIDE))
    sure = np.random.default_rng(5).random((SIDE, SIDE)) < 0.3
    found = described_surface(image, inverse.copy(), sure, 24.0)
    assert np.abs(found.surface.inverse - inverse).max() < 1e-4  # found: 6e-6
    assert found.residual.max() < 0.01
    across = described_surface(image, inverse.copy(), sure, 24.0, edges=False)
    assert np.abs(across.surface.inverse - inverse)[:, SIDE // 2 - 4 : SIDE // 2 + 4].min() > 0.05
    assert across.residual[:, SIDE // 2].min() > 0.1


def test_weights_are_their_definition() -> None:
    """A single pixel spreads by exp(-sqrt(2) way / reach) along its row, then along columns."""
    rng = np.random.default_rng(1)
    image, reach = rng.random((3, 7, 9), dtype=np.float32), 5.0
    point = np.zeros((7, 9))
    point[3, 4] = 1
    found = _weighted_sums(point, _steps(image, 2, reach, True), _steps(image, 1, reach, True))
    for row, column in np.ndindex(7, 9):
        way = 0.0
        for a in range(min(column, 4), max(column, 4)):
            way += 1 + reach / EDGE * np.abs(image[:, 3, a + 1].astype(float) - image[:, 3, a]).sum()
        for b in range(min(row, 3), max(row, 3)):
            way += 1 + reach / EDGE * np.abs(image[:, b + 1, column].astype(float) - image[:, b, column]).sum()
        assert found[row, column] == pytest.approx(np.exp(-np.sqrt(2) * way / reach), rel=1e-9, abs=1e-300)


def test_a_surface_is_a_weighted_fit_by_least_squares() -> None:
    """Of one pixel, by numpy's solver: the plane, its weight, how far points lie off it and how far away they are."""
    rng = np.random.default_rng(2)
    height, width, reach, (row, column) = 9, 12, 4.0, (2, 7)
    inverse, sure = rng.uniform(1, 2, (height, width)), rng.random((height, width)) < 0.4
    told = described_surface(np.full((3, height, width), 0.3), inverse, sure, reach)
    found = told.surface
    y, x = np.mgrid[:height, :width].astype(float)
    weight = sure * np.exp(-np.sqrt(2) / reach * (np.abs(y - row) + np.abs(x - column)))
    mean_x, mean_y, mean = ((weight * values).sum() / weight.sum() for values in (x, y, inverse))
    terms = np.stack([(x - mean_x).ravel(), (y - mean_y).ravel()], axis=1)
    share = weight.ravel() / weight.sum()
    moments = terms.T @ (share[:, None] * terms) + RIDGE * reach**2 * np.eye(2)
    slopes = np.linalg.solve(moments, terms.T @ (share * (inverse.ravel() - mean)))
    assert found.weight[row, column] == pytest.approx(weight.sum())
    assert found.inverse[row, column] == pytest.approx(mean + slopes @ [column - mean_x, row - mean_y])
    explained = slopes @ (terms.T @ (share * (inverse.ravel() - mean)))
    spread = np.sqrt((share * (inverse.ravel() - mean) ** 2).sum() - explained)
    assert told.residual[row, column] == pytest.approx(spread)
    assert told.away[row, column] == pytest.approx(np.hypot(column - mean_x, row - mean_y) / reach)


def test_where_nothing_sure_is_near_nothing_is_known() -> None:
    sure = np.zeros((SIDE, SIDE), bool)
    sure[:4, :4] = True
    told = described_surface(FLAT, np.ones((SIDE, SIDE)), sure, 2.0)
    found = told.surface
    assert found.known[:8, :8].all()
    assert not found.known[-8:, -8:].any()
    assert (found.weight[-8:, -8:] <= LEAST).all()
    assert all(np.isfinite(plane).all() for plane in (*found, told.residual, told.away))
    assert (found.within(np.full((SIDE, SIDE), 0.7), sure)[-8:, -8:] == 0.7).all()


def test_a_plane_ends_where_the_view_does() -> None:
    """Slopes are not followed beyond the depths that there are."""
    inverse = np.broadcast_to(0.2 + 0.01 * np.minimum(np.arange(SIDE), 20), (SIDE, SIDE)).copy()
    sure = np.broadcast_to(np.arange(SIDE) < 20, (SIDE, SIDE))
    found = surface(FLAT, inverse, sure, 6.0)
    assert found.inverse[:, -1].min() > 0.45
    assert found.within(inverse, np.ones_like(sure))[:, -1] == pytest.approx(0.4)
