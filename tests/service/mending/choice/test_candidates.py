"""The features of the candidates: each number by its meaning, for any world, unit and order of views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import PATCH, SIDE, in_another_world, plane_depths, with_wrong_patch

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.confirmed import confirmed
from gapmes.service.matching.correspondence import pixels_per_inverse_depth
from gapmes.service.matching.match_cost import CostAggregation, difference, features
from gapmes.service.matching.window_match import contrast
from gapmes.service.mending.choice.candidates import ABOUT, COUNT, KNOWN, REACHES, Candidates, Matched
from gapmes.service.mending.surfaces import described_surface
from gapmes.service.photographs.bilinear import bilinear
from gapmes.service.photographs.images import FittedView


def of_first(views: list[FittedView], depths: np.ndarray, *others: np.ndarray) -> Candidates:
    found = Matched(views, depths, others or (depths, depths)).candidates(0)
    assert found is not None
    return found


def placed(found: Candidates, candidate: int, number: int) -> np.ndarray:
    """(H, W) one number of one candidate, NaN where there is no choice."""
    plane = np.full(found.undecided.shape, np.nan)
    plane[found.undecided] = found.known[candidate, number]
    return plane


def _grid() -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_they_are_the_depths_that_were_given_and_surfaces(views: list[FittedView], spoiled: np.ndarray) -> None:
    truth = plane_depths(views)
    found = of_first(views, spoiled, 1.1 * truth, 1.3 * truth)
    assert found.inverse.shape == (COUNT, SIDE, SIDE)
    assert found.known.shape == (COUNT, KNOWN, found.undecided.sum())
    assert found.about.shape == (ABOUT, found.undecided.sum())
    for place, depths in enumerate((spoiled, 1.1 * truth, 1.3 * truth)):
        assert found.inverse[place] == pytest.approx(found.disparity_scale / depths[0])
    for place in range(3, COUNT):  # the patch lies in the plane that is confirmed about it
        assert np.median(np.abs(found.inverse[place] * truth[0] / found.disparity_scale - 1)[PATCH]) < 0.01
    assert (np.abs(found.known) <= 2).all()
    assert (np.abs(found.about) <= 2).all()


def test_undecided_is_what_is_kept_and_not_confirmed(views: list[FittedView], spoiled: np.ndarray) -> None:
    assert (of_first(views, spoiled).undecided == ~confirmed(views, spoiled)[0]).all()
    mask = np.ones((SIDE, SIDE), bool)
    mask[20:30] = False
    masked = [replace(views[0], mask=mask), *views[1:]]
    assert (of_first(masked, spoiled).undecided == (mask & ~confirmed(masked, spoiled)[0])).all()


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
    assert (found.known[0, 8] == inside[found.undecided]).all()


def test_a_masked_place_is_inside_a_picture(views: list[FittedView]) -> None:
    """A depth that leads into another view's mask is wrong, and may go away as far as it must."""
    truth, mask = plane_depths(views)[:2], np.ones((SIDE, SIDE), bool)
    mask[:, : SIDE // 2] = False
    bare, masked = views[:2], [views[0], replace(views[1], mask=mask)]
    assert (of_first(masked, truth).outside == of_first(bare, truth).outside).all()
    for pair, hidden in ((masked, True), (bare, False)):
        found = of_first(pair, truth)
        assert (placed(found, 0, 8)[found.undecided & ~found.outside] == 0).any() == hidden


def by_definition(views: list[FittedView], stacks: list[np.ndarray], row: int, column: int) -> tuple[list, list]:
    """What is known of one pixel of the first of two views, from the definitions: nothing of whole pictures but the
    surfaces and gathered differences, which have tests of their own."""
    view, other = views
    sure = confirmed(views, stacks[0])
    way = pixels_per_inverse_depth(view, other)
    inverse = [way / stack[0] for stack in stacks]
    told = [described_surface(view.image, inverse[0], sure[0], reach, edges=edges) for reach, edges in REACHES]
    inverse += [one.surface.within(inverse[0], view.kept) for one in told]
    own, others = features(view), features(other)
    place, middle = (row, column), np.median([plane[row, column] for plane in inverse])
    known = []
    for candidate, plane in enumerate(inverse):
        cost = CostAggregation(view, view.kept).of(difference(view, own, way / plane, other, others))[place]
        point = view.camera.unproject(np.array([[column + 0.5, row + 0.5]]), np.array([way / plane[place]]))
        (px,), (z,) = other.camera.project(point)
        seen = bool(z > 0 and (px > 0).all() and (px < SIDE).all())
        theirs, certain = (
            bilinear(values[..., None], *(np.array([[value]]) for value in px - 0.5))[0, 0, 0]
            for values in (1 / stacks[0][1], sure[1].astype(float))
        )
        front = np.clip((1 / z - theirs) * way, -16, 16)
        one = [np.tanh((plane[place] - inverse[from_][place]) / scale) for from_ in (0, 1) for scale in (4, 32)]
        if candidate < 3:
            one += [0.0, 0.0, 0.0]
        else:
            about = told[candidate - 3]
            weight = max(about.surface.weight[place], 1e-9)
            near = float(about.surface.weight[place] > 1e-9)
            one += [
                np.log10(weight) / 9,
                near * np.tanh(about.residual[place] / 2),
                near * np.tanh(about.away[place] / 2),
            ]
        one += [cost / 0.25, float(seen), seen * np.tanh(front / 2), seen * certain]
        one += [np.tanh((plane[place] - middle) / 4)]
        one += [np.mean([abs(plane[place] - each[place]) < 1.5 for each in inverse]), np.log1p(plane[place]) / 5]
        known.append(one)
    low, high = inverse[0].min(), inverse[0].max()
    texture = contrast(view.grey, view.kept)[place] / 0.05
    about_pixel = [
        np.log1p(min(row, column, SIDE - 1 - row, SIDE - 1 - column)) / 4,
        min(texture, 2),
        np.tanh((middle - inverse[0][place]) / 4),
        np.tanh(np.std([plane[place] for plane in inverse]) / 4),
        sure[0].mean(),
        (inverse[0][place] - low) / (high - low),
        np.tanh((inverse[0][place] - inverse[1][place]) / 4),
    ]
    return known, about_pixel


def test_every_number_is_its_definition(views: list[FittedView]) -> None:
    """The shipped weights were trained by these numbers, in this order."""
    pair, rng = views[:2], np.random.default_rng(8)
    depths = with_wrong_patch(pair, 1.15)
    stacks = [depths, depths * rng.uniform(0.9, 1.1, depths.shape), depths * rng.uniform(0.95, 1.05, depths.shape)]
    found = of_first(pair, *stacks)
    rows, columns = np.nonzero(found.undecided)
    for number in rng.choice(len(rows), 40, replace=False):
        known, about = by_definition(pair, stacks, rows[number], columns[number])
        assert found.known[..., number].astype(float) == pytest.approx(np.array(known), abs=2e-3)  # of float16
        assert found.about[:, number].astype(float) == pytest.approx(np.array(about), abs=2e-3)


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
