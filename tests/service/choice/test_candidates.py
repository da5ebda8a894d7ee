"""What is known of the candidates: each number by its meaning, whatever the world, its unit and the order of views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import PATCH, SIDE, in_another_world, plane_depths, plane_views, with_wrong_patch

from gapmes.service.choice.candidates import ABOUT, COUNT, KNOWN, Candidates, Matched
from gapmes.service.confirmed import confirmed
from gapmes.service.images import FittedView
from gapmes.service.rotations import about_axis


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    return plane_views()


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> np.ndarray:
    return with_wrong_patch(views, 1.2)


def of_first(views: list[FittedView], depths: np.ndarray, *others: np.ndarray) -> Candidates:
    found = Matched(views, depths, others or (depths, depths)).candidates(0)
    assert found is not None
    return found


def placed(found: Candidates, candidate: int, number: int) -> np.ndarray:
    """(H, W) one number of one candidate, NaN where there is no choice."""
    plane = np.full(found.open.shape, np.nan)
    plane[found.open] = found.known[candidate, number]
    return plane


def test_they_are_the_depths_that_were_given_and_surfaces(views: list[FittedView], spoiled: np.ndarray) -> None:
    truth = plane_depths(views)
    found = of_first(views, spoiled, 1.1 * truth, 1.3 * truth)
    assert found.inverse.shape == (COUNT, SIDE, SIDE)
    assert found.known.shape == (COUNT, KNOWN, found.open.sum())
    assert found.about.shape == (ABOUT, found.open.sum())
    for place, depths in enumerate((spoiled, 1.1 * truth, 1.3 * truth)):
        assert found.inverse[place] == pytest.approx(found.way / depths[0])
    for place in range(3, COUNT):  # the patch lies in the plane that is confirmed about it
        assert np.median(np.abs(found.inverse[place] * truth[0] / found.way - 1)[PATCH]) < 0.01
    assert (np.abs(found.known) <= 2).all()
    assert (np.abs(found.about) <= 2).all()


def test_open_is_what_is_kept_and_not_confirmed(views: list[FittedView], spoiled: np.ndarray) -> None:
    assert (of_first(views, spoiled).open == ~confirmed(views, spoiled)[0]).all()
    mask = np.ones((SIDE, SIDE), bool)
    mask[20:30] = False
    masked = [replace(views[0], mask=mask), *views[1:]]
    assert (of_first(masked, spoiled).open == (mask & ~confirmed(masked, spoiled)[0])).all()


def test_a_true_depth_is_known_by_its_match_and_a_wrong_one_by_the_surface_behind_it(
    views: list[FittedView], spoiled: np.ndarray
) -> None:
    """The eighth number is the difference of photographs, the tenth how far it is in front of what others see."""
    truth = plane_depths(views)
    found = of_first(views, spoiled, truth, 0.8 * truth)
    match = [np.nanmedian(placed(found, place, 7)[PATCH]) for place in range(2)]
    assert match[1] < 0.5 * match[0]
    wrong, right, near = (np.nanmedian(placed(found, place, 9)[PATCH]) for place in range(3))
    assert right == pytest.approx(0, abs=0.2)
    assert wrong < -0.5 < 0.5 < near


def test_outside_is_what_no_other_view_has_in_its_picture(views: list[FittedView]) -> None:
    truth = plane_depths(views)
    pair = views[:2]
    found = of_first(pair, truth[:2])
    place, _ = pair[1].camera.project(pair[0].camera.unproject(_grid(), truth[0].ravel()))
    inside = ((place > 0) & (place < SIDE)).all(axis=1).reshape(SIDE, SIDE)
    assert 0 < found.outside.mean() < 1
    assert (found.outside == ~inside).all()
    assert (found.known[0, 8] == inside[found.open]).all()


def _grid() -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_views_without_anything_to_choose_by_have_none(views: list[FittedView]) -> None:
    truth = plane_depths(views)
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in views]
    assert Matched(flat, truth, (truth, truth)).candidates(0) is None  # nothing is confirmed
    same = [views[0], replace(views[1], camera=views[0].camera)]
    assert Matched(same, truth[:2], (truth[:2], truth[:2])).candidates(0) is None  # from one place


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(
    unit: float, offset: float, views: list[FittedView], spoiled: np.ndarray
) -> None:
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    here = of_first(views, spoiled)
    there = of_first(in_another_world(views, turn, shift, unit), unit * spoiled)
    np.testing.assert_allclose(there.inverse, here.inverse, rtol=1e-6)
    apart = np.abs(there.known.astype(float) - here.known)
    assert np.quantile(apart, 0.999) < 2e-3  # of float16; single ones at an edge of a picture


def test_the_order_of_other_views_does_not_matter(views: list[FittedView], spoiled: np.ndarray) -> None:
    order = [0, 2, 1]
    here, there = of_first(views, spoiled), of_first([views[i] for i in order], spoiled[order])
    np.testing.assert_allclose(there.known.astype(float), here.known, atol=2e-3)  # of float16
