"""Continued depths: a plane goes on through unconfirmed pixels if the photographs agree, and nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import PATCH, SIDE, in_another_world, plane_depths

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.confirmed import confirmed
from gapmes.service.matching.correspondence import reprojected
from gapmes.service.mending.continued import continued
from gapmes.service.photographs.images import FittedView


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
        seen = reprojected(views[0], truth[0], view)
        image = view.image.copy()
        rows, columns = (np.round(axis[PATCH]).astype(int).clip(0, SIDE - 1) for axis in (seen.row, seen.column))
        box = np.s_[:, max(rows.min() - 8, 0) : rows.max() + 9, max(columns.min() - 8, 0) : columns.max() + 9]
        image[box] = rng.random(image[box].shape, dtype=np.float32)
        strangers.append(replace(views[index], image=image))
    found = continued([views[0], *strangers], spoiled)
    assert (found[0][PATCH] == spoiled[0][PATCH]).mean() > 0.9  # found: 0.996


def test_one_view_that_matches_is_enough(views: list[FittedView], spoiled: np.ndarray) -> None:
    """Whichever it is; the other one shows noise, where it confirms nothing."""
    noise = np.random.default_rng(8).random(views[0].image.shape, dtype=np.float32)
    for stranger in (1, 2):
        mixed = list(views)
        mixed[stranger] = replace(views[stranger], image=noise)
        found = np.abs(continued(mixed, spoiled)[0] / plane_depths(views)[0] - 1)[PATCH]
        assert (found < 0.01).mean() > 0.9


def test_a_twin_tells_nothing_and_disturbs_nothing(views: list[FittedView], spoiled: np.ndarray) -> None:
    """From the same position every depth matches."""
    pair, twin = continued(views[:2], spoiled[:2]), continued([*views[:2], views[0]], spoiled[[0, 1, 0]])
    assert (twin[0] == pair[0]).all()


def test_what_stands_before_the_plane_and_nobody_else_sees_stays(
    views: list[FittedView], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So near that it lies beside the other pictures: a grey thing, like enough to the plane behind it to be confused
    with that if any match were better than none."""
    truth = plane_depths(views)
    depths = truth.copy()
    depths[0][PATCH] /= 4
    for other in views[1:]:
        assert not reprojected(views[0], depths[0], other).where[PATCH].any()
    image = views[0].image.copy()
    image[(slice(None), *PATCH)] = np.random.default_rng(9).uniform(0.4, 0.6, (3, 16, 16))
    thing = [replace(views[0], image=image), *views[1:]]
    assert (continued(thing, depths)[0] == depths[0])[PATCH].mean() > 0.95  # found: all
    assert (np.abs(continued(views, depths)[0] / truth[0] - 1) < 0.01)[PATCH].mean() > 0.95  # the plane itself: all
    monkeypatch.setattr("gapmes.service.mending.continued.SURE_MATCH", 1.0)
    assert (continued(thing, depths)[0] == depths[0])[PATCH].mean() < 0.5  # found: 0.31


@pytest.mark.parametrize("hidden", [1e-3, 1e3])
def test_masked_pixels_stay_and_their_depths_do_not_matter(
    hidden: float, views: list[FittedView], spoiled: np.ndarray
) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[28:36, 28:36] = False
    masked, other = [replace(views[0], mask=mask), *views[1:]], spoiled.copy()
    other[0][~mask] = hidden
    found, changed = continued(masked, spoiled), continued(masked, other)
    assert (found[0] != spoiled[0])[mask].any()
    assert (changed[0] == other[0])[~mask].all()
    assert (changed[0] == found[0])[mask].all()


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(
    unit: float, offset: float, views: list[FittedView], spoiled: np.ndarray
) -> None:
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    moved = in_another_world(views, turn, shift, unit)
    here, there = continued(views, spoiled), continued(moved, unit * spoiled) / unit
    assert (np.abs(here / there - 1) > 1e-6).mean() < 2e-3  # rounding at a tie
