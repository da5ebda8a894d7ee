"""The choice: the preferred candidate, only for undecided pixels, and never one that would reveal the unseen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import PATCH, SIDE, plane_depths

from gapmes.service.matching.confirmed import confirmed
from gapmes.service.mending.choice.candidates import ABOUT, COUNT, FREE, KNOWN, REACHES, Matched
from gapmes.service.mending.choice.chosen import BACK, chosen, preferred
from gapmes.service.mending.choice.network import ChoiceNetwork, shipped_choice
from gapmes.service.photographs.images import FittedView


def _grid() -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.stack([x.ravel(), y.ravel()], axis=1)


def always(place: int) -> ChoiceNetwork:
    """Prefers one candidate regardless of its features."""
    zeros = [np.zeros(shape, np.float32) for shape in ((KNOWN, 1), (ABOUT, 1), (COUNT, 1), (1, 1), (1, 1), 1, 1)]
    prior = np.zeros(COUNT, np.float32)
    prior[place] = 20
    return ChoiceNetwork(*zeros, prior)


def test_the_preferred_candidate_is_taken_where_nothing_is_confirmed(
    views: list[FittedView], spoiled: np.ndarray
) -> None:
    truth, sure = plane_depths(views), confirmed(views, spoiled)
    found = chosen(views, spoiled, (truth, 1.1 * truth), always(1))
    assert (found[sure] == spoiled[sure]).all()
    assert found[~sure] == pytest.approx(truth[~sure])
    assert (chosen(views, spoiled, (truth, truth), always(0)) == spoiled).all()


def test_what_a_mask_leaves_out_stays(views: list[FittedView], spoiled: np.ndarray) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[PATCH] = False
    masked = [replace(views[0], mask=mask), *views[1:]]
    found = chosen(masked, spoiled, (2 * spoiled, spoiled), always(1))
    assert (found[0] == spoiled[0])[~mask].all()
    assert (found[0] != spoiled[0])[mask].any()


def test_what_no_other_view_shows_does_not_go_far_away(views: list[FittedView]) -> None:
    """Nearer it may come, and a little farther it may go."""
    pair, truth = views[:2], plane_depths(views)[:2]
    way = pair[0].camera.fx * np.linalg.norm(pair[0].camera.center - pair[1].camera.center)
    sure = confirmed(pair, truth)
    place, _ = pair[1].camera.project(pair[0].camera.unproject(_grid(), truth[0].ravel()))
    outside = ~((place > 0) & (place < SIDE)).all(axis=1).reshape(SIDE, SIDE) & ~sure[0]
    assert outside.mean() > 0.02
    inverse = way / truth
    for px, moves in ((-BACK * SIDE - 1, False), (-BACK * SIDE + 1, True), (20.0, True)):
        other = way / np.maximum(inverse + px, 0.5)
        found = chosen(pair, truth, (other, truth), always(1))
        assert (found[0] != truth[0])[outside].all() == moves
        assert (found[0] == truth[0])[outside].all() != moves


def test_what_no_other_view_shows_goes_to_a_surface_that_is_confirmed_nearby(views: list[FittedView]) -> None:
    """And stays where the confirmed pixels are far off. Surfaces across image edges do not count."""
    pair, truth = views[:2], plane_depths(views)[:2]
    place, _ = pair[1].camera.project(pair[0].camera.unproject(_grid(), truth[0].ravel()))
    beyond = ~((place > 0) & (place < SIDE)).all(axis=1).reshape(SIDE, SIDE)
    near = truth.copy()
    near[0][beyond] /= 1.9
    way = pair[0].camera.fx * np.linalg.norm(pair[0].camera.center - pair[1].camera.center)
    assert (way / near - way / truth)[0][beyond].min() > BACK * SIDE + 1
    candidates = Matched(pair, near, (near, near)).candidates(0)
    assert candidates is not None
    place = FREE + REACHES.index((6.0, True))
    beside = candidates.outside & candidates.nearby[place]
    far_off = candidates.outside & ~candidates.nearby[place]
    assert min(beside.sum(), far_off.sum()) > 100
    assert not candidates.nearby[:FREE].any()
    assert not candidates.nearby[FREE + REACHES.index((24.0, False))].any()
    found = chosen(pair, near, (near, near), always(place))
    assert np.median(np.abs(found[0] / truth[0] - 1)[beside]) < 0.01
    assert (found[0] == near[0])[far_off].all()


def test_what_a_mask_of_the_other_view_hides_goes_as_far_as_it_must(views: list[FittedView]) -> None:
    """A depth that leads there is wrong; that the other view does not see it is no reason to keep it."""
    pair, truth = views[:2], plane_depths(views)[:2]
    near = truth.copy()
    near[0][PATCH] /= 1.9
    place, _ = pair[1].camera.project(pair[0].camera.unproject(_grid(), near[0].ravel()))
    column, row = (place.reshape(SIDE, SIDE, 2)[PATCH].reshape(-1, 2).T).astype(int)
    mask = np.ones((SIDE, SIDE), bool)
    mask[max(row.min() - 1, 0) : row.max() + 2, max(column.min() - 1, 0) : column.max() + 2] = False
    masked = [pair[0], replace(pair[1], mask=mask)]
    way = pair[0].camera.fx * np.linalg.norm(pair[0].camera.center - pair[1].camera.center)
    assert np.median((way / near - way / truth)[0][PATCH]) > BACK * SIDE + 1
    found = chosen(masked, near, (truth, truth), always(1))
    assert np.median(np.abs(found[0] / truth[0] - 1)[PATCH]) < 1e-6


def test_a_single_pixel_is_outvoted_by_those_about_it(
    views: list[FittedView], spoiled: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Matched(views, spoiled, (spoiled, spoiled)).candidates(0)
    assert found is not None
    alone = np.flatnonzero(found.undecided).tolist().index(32 * SIDE + 32)

    def preferences(self: ChoiceNetwork, known: np.ndarray, about: np.ndarray) -> np.ndarray:
        shares = np.zeros((COUNT, known.shape[2]))
        shares[4] = 1
        shares[4, alone], shares[2, alone] = 0, 1
        return shares

    monkeypatch.setattr(ChoiceNetwork, "preferences", preferences)
    flat = replace(views[0], image=np.full_like(views[0].image, 0.4))
    assert (preferred(flat, found, shipped_choice())[found.undecided] == 4).all()


def test_the_shipped_network_brings_a_wrong_patch_back(views: list[FittedView], spoiled: np.ndarray) -> None:
    truth = plane_depths(views)
    found = chosen(views, spoiled, (spoiled, spoiled), shipped_choice())
    wrong = [np.abs(depths[0] / truth[0] - 1)[PATCH] for depths in (spoiled, found)]
    assert np.median(wrong[1]) < 0.1 * np.median(wrong[0])
