"""Continued depths: a plane goes on where it is not confirmed, if the photographs say so, and nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import SIDE, in_another_world, plane_depths, plane_views

from gapmes.service.confirmed import confirmed
from gapmes.service.continued import EDGE, _along, _planes, _spread, continued
from gapmes.service.correspondence import seen_by
from gapmes.service.images import FittedView
from gapmes.service.rotations import about_axis

PATCH = np.s_[24:40, 24:40]


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    return plane_views()


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> np.ndarray:
    """The plane's depths, but for a patch of the first view that lies a fifth too far."""
    depths = plane_depths(views)
    depths[0][PATCH] *= 1.2
    return depths


def test_a_wrong_patch_returns_to_the_plane(views: list[FittedView], spoiled: np.ndarray) -> None:
    truth = plane_depths(views)
    found = continued(views, spoiled)
    wrong = np.abs(found[0] / truth[0] - 1)[PATCH]
    assert (wrong < 0.01).mean() > 0.95  # found: all, half of them within 0.0006


def test_confirmed_depths_keep_their_bits(views: list[FittedView], spoiled: np.ndarray) -> None:
    sure = confirmed(views, spoiled)
    assert 0.3 < sure.mean() < 1
    assert (continued(views, spoiled)[sure] == spoiled[sure]).all()


def test_without_a_confirmed_pixel_all_stays(views: list[FittedView]) -> None:
    depths = plane_depths(views) * np.random.default_rng(3).uniform(0.5, 2, (3, SIDE, SIDE))
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in views]
    assert (continued(flat, depths) == depths).all()
    masked = [replace(view, mask=np.zeros((SIDE, SIDE), bool)) for view in views]
    assert (continued(masked, depths) == depths).all()


def test_what_fits_no_better_stays(views: list[FittedView], spoiled: np.ndarray) -> None:
    """The other views show another texture there: the plane gains nothing."""
    rng, truth = np.random.default_rng(8), plane_depths(views)
    strangers = []
    for index, view in enumerate(views[1:], start=1):
        seen = seen_by(views[0], truth[0], view)
        image = view.image.copy()
        rows, columns = (np.round(axis[PATCH]).astype(int).clip(0, SIDE - 1) for axis in (seen.row, seen.column))
        box = np.s_[:, max(rows.min() - 8, 0) : rows.max() + 9, max(columns.min() - 8, 0) : columns.max() + 9]
        image[box] = rng.random(image[box].shape, dtype=np.float32)
        strangers.append(replace(views[index], image=image))
    found = continued([views[0], *strangers], spoiled)
    assert (found[0][PATCH] == spoiled[0][PATCH]).mean() > 0.9  # found: 0.996


def test_masked_pixels_stay_and_are_not_looked_at(views: list[FittedView], spoiled: np.ndarray) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[28:36, 28:36] = False
    hidden = replace(views[0], mask=mask)
    found = continued([hidden, *views[1:]], spoiled)
    assert (found[0][~mask] == spoiled[0][~mask]).all()
    other = replace(hidden, image=np.where(mask, hidden.image, 0.5).astype(np.float32))
    near = np.zeros((SIDE, SIDE), bool)
    near[20:44, 20:44] = True  # windows about it, and rows and columns across it
    changed = continued([other, *views[1:]], spoiled)[0] != found[0]
    assert not changed[~near].any()


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(
    unit: float, offset: float, views: list[FittedView], spoiled: np.ndarray
) -> None:
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    moved = in_another_world(views, turn, shift, unit)
    here, there = continued(views, spoiled), continued(moved, unit * spoiled) / unit
    assert (np.abs(here / there - 1) > 1e-6).mean() < 2e-3  # rounding at a tie


def test_a_plane_is_found_from_a_few_of_its_pixels(views: list[FittedView]) -> None:
    """Inverse depth is linear in the position."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    inverse = 0.5 + 0.2 * x - 0.1 * y
    sure = np.random.default_rng(5).random((SIDE, SIDE)) < 0.3
    flat = replace(views[0], image=np.full_like(views[0].image, 0.5))
    found = _planes(flat, np.where(sure, inverse, 0.35 + 0.4 * (x > 0.5)), sure, 6.0)
    assert (
        np.abs(found - inverse)[8:-8, 8:-8].max() < 1e-3
    )  # found: 1.3e-4: the ridge's share of the slope


def test_an_edge_keeps_surfaces_apart(views: list[FittedView]) -> None:
    left = np.arange(SIDE) < SIDE // 2
    image = np.broadcast_to(np.where(left, 0.2, 0.8).astype(np.float32), (3, SIDE, SIDE))
    inverse = np.broadcast_to(np.where(left, 1.0, 0.5), (SIDE, SIDE))
    sure = np.random.default_rng(5).random((SIDE, SIDE)) < 0.3
    found = _planes(replace(views[0], image=image), inverse.copy(), sure, 24.0)
    assert np.abs(found - inverse).max() < 1e-4  # found: 6e-6


def test_weights_are_their_definition() -> None:
    """A single pixel spreads by exp(-sqrt(2) way / reach) along its row, then along columns."""
    rng = np.random.default_rng(1)
    image, reach = rng.random((3, 7, 9), dtype=np.float32), 5.0
    point = np.zeros((1, 7, 9))
    point[0, 3, 4] = 1
    found = _spread(point, image, reach)[0]
    for row, column in np.ndindex(7, 9):
        way = 0.0
        for a in range(min(column, 4), max(column, 4)):
            way += 1 + reach / EDGE * np.abs(image[:, 3, a + 1].astype(float) - image[:, 3, a]).sum()
        for b in range(min(row, 3), max(row, 3)):
            way += 1 + reach / EDGE * np.abs(image[:, b + 1, column].astype(float) - image[:, b, column]).sum()
        assert found[row, column] == pytest.approx(np.exp(-np.sqrt(2) * way / reach), rel=1e-9, abs=1e-300)


def test_sums_along_an_axis_go_both_ways() -> None:
    values, weights = np.array([1.0, 10.0, 100.0])[:, None, None], np.array([0.5, 0.1])[:, None]
    assert _along(values, weights)[:, 0, 0] == pytest.approx([1 + 5 + 5, 10 + 0.5 + 10, 100 + 1 + 0.05])
