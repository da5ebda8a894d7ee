"""Searched depths: a wrong surface is corrected anywhere in the range, and nothing moves without a better match."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import WAVES, photograph
from plane_views import PATCH, SIDE, in_another_world, plane_depths, with_wrong_patch

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.confirmed import confirmed
from gapmes.service.matching.correspondence import pixels_per_inverse_depth
from gapmes.service.mending.searched import PAIR_PX, searched
from gapmes.service.photographs.images import FittedView, Photo, fit_view

FAR = 1.8  # times as far as it is: 6 to 12 px of parallax


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> np.ndarray:
    return with_wrong_patch(views, FAR)


def off_px(views: list[FittedView], depths: np.ndarray) -> np.ndarray:
    """(V, H, W) px of parallax between `depths` and the plane's, in the view that is farthest away."""
    most = [max(pixels_per_inverse_depth(a, b) for b in views if b is not a) for a in views]
    return np.abs(1 / depths - 1 / plane_depths(views)) * np.array(most)[:, None, None]


@pytest.mark.parametrize("count", [2, 3])
def test_a_wrong_patch_is_found_again(count: int, views: list[FittedView], spoiled: np.ndarray) -> None:
    """Up to the next level."""
    found = searched(views[:count], spoiled[:count])
    assert off_px(views[:count], spoiled[:count])[0][PATCH].min() > 3
    assert (off_px(views[:count], found)[0][PATCH] < 1).mean() > 0.95  # found: all, by 0.35 px at most


def test_threads_change_nothing(views: list[FittedView], spoiled: np.ndarray) -> None:
    assert (searched(views, spoiled, 1) == searched(views, spoiled, 3)).all()


def test_the_truth_is_not_left(views: list[FittedView]) -> None:
    moved = off_px(views, searched(views, plane_depths(views)))
    assert (moved > 0).mean() < 0.03  # found: 0.017
    assert (moved > 1).mean() < 0.01  # found: 0.004


def test_confirmed_depths_keep_their_bits(views: list[FittedView], spoiled: np.ndarray) -> None:
    sure = confirmed(views, spoiled)
    assert 0.3 < sure.mean() < 1
    assert (searched(views, spoiled)[sure] == spoiled[sure]).all()


def test_nothing_to_compare_leaves_the_bits(views: list[FittedView], spoiled: np.ndarray) -> None:
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in views]
    assert (searched(flat, spoiled) == spoiled).all()
    masked = [replace(view, mask=np.zeros((SIDE, SIDE), bool)) for view in views]
    assert (searched(masked, spoiled) == spoiled).all()
    same_place = [views[0]] * 3
    assert (searched(same_place, spoiled[[0, 0, 0]]) == spoiled[[0, 0, 0]]).all()


def test_strangers_are_not_followed(views: list[FittedView], spoiled: np.ndarray) -> None:
    """Noise matches somewhere; what leads back to nothing is not taken."""
    rng = np.random.default_rng(8)
    noise = [replace(view, image=rng.random(view.image.shape, dtype=np.float32)) for view in views]
    assert (searched(noise, spoiled) == spoiled).mean() > 0.9  # found: 0.998


def test_one_view_that_matches_is_enough(views: list[FittedView], spoiled: np.ndarray) -> None:
    noise = np.random.default_rng(8).random(views[0].image.shape, dtype=np.float32)
    for stranger in (1, 2):
        mixed = list(views)
        mixed[stranger] = replace(views[stranger], image=noise)
        assert (off_px(mixed, searched(mixed, spoiled))[0][PATCH] < 1).mean() > 0.9  # found: all


def test_a_twin_from_the_same_place_hides_nothing(views: list[FittedView], spoiled: np.ndarray) -> None:
    """Every depth matches there; were it compared, none of the patch would be found."""
    with_twin = [*views, views[0]]
    found = searched(with_twin, spoiled[[0, 1, 2, 0]])
    assert (off_px(views, found[:3])[0][PATCH] < 1).mean() > 0.95  # found: all


def test_views_on_a_line_do_not_depend_on_their_order_or_the_world() -> None:
    """Steps are equal, so that some are as near as others: which three are compared must not follow from a number."""
    rng, count = np.random.default_rng(8), 5
    row = along_a_line(count)
    for noisy in (0, 1, 3):
        row[noisy] = replace(row[noisy], image=rng.random(row[noisy].image.shape, dtype=np.float32))
    depths = plane_depths(row)
    depths[2][PATCH] *= FAR
    right = plane_depths(row)[2][PATCH]

    def found(views: list[FittedView], number: int) -> float:
        order = depths[[row_numbers[id(view.image)] for view in views]]
        return float((np.abs(searched(views, order)[number][PATCH] / right - 1) < 0.05).mean())

    row_numbers = {id(view.image): number for number, view in enumerate(row)}
    assert found(row, 2) > 0.9
    assert found([row[i] for i in (4, 1, 2, 3, 0)], 2) > 0.9
    turned = in_another_world(row, about_axis(np.array([0.0, 0.0, 1.0]), 2.3), np.zeros(3), 1.0)
    assert found(turned, 2) > 0.9


def along_a_line(count: int) -> list[FittedView]:
    """The plane from places in equal steps, by one lens."""
    rng = np.random.default_rng(5)
    waves = rng.normal(size=(3, WAVES, 2)) * rng.choice([2.0, 7.0, 14.0], size=(3, WAVES, 1))
    phases, views = rng.uniform(0, 2 * np.pi, size=(3, WAVES)), []
    for number in range(count):
        pose = np.eye(4)
        pose[0, 3] = 0.3 * (number - (count - 1) / 2)
        camera = Camera.make(SIDE, SIDE, 76.8, 76.8, SIDE / 2, SIDE / 2, pose)
        views.append(fit_view(Photo(photograph(camera, waves, phases)), camera, SIDE, SIDE))
    return views


def test_a_pair_stays_one_beside_a_twin(views: list[FittedView], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gapmes.service.mending.searched.PAIR_PX", 3.0)
    trio, depths = [*views[:2], views[0]], plane_depths(views)[[0, 1, 0]]
    depths = depths * np.random.default_rng(3).uniform(0.3, 3, depths.shape)
    ways = [pixels_per_inverse_depth(trio[a], trio[b]) for a, b in ((0, 1), (1, 0), (2, 1))]
    moved = np.abs(1 / searched(trio, depths) - 1 / depths) * np.array(ways)[:, None, None]
    assert 2.5 < moved.max() < 3.0


def test_a_pair_does_not_go_far(views: list[FittedView], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing tells whether a match is the right one of several."""
    pair, depths = views[:2], plane_depths(views)[:2] * np.random.default_rng(3).uniform(0.3, 3, (2, SIDE, SIDE))
    ways = np.array([pixels_per_inverse_depth(*pair), pixels_per_inverse_depth(*pair[::-1])])[:, None, None]
    monkeypatch.setattr("gapmes.service.mending.searched.PAIR_PX", 3.0)
    assert 2.5 < (np.abs(1 / searched(pair, depths) - 1 / depths) * ways).max() < 3.0
    monkeypatch.setattr("gapmes.service.mending.searched.PAIR_PX", PAIR_PX)
    assert (np.abs(1 / searched(pair, depths) - 1 / depths) * ways).max() > 3.0


def test_one_wild_depth_does_not_widen_the_range(views: list[FittedView], spoiled: np.ndarray) -> None:
    """Levels would be so far apart that the patch fell between them."""
    wild = spoiled.copy()
    wild[1, 0, 0] /= 1e6
    assert (off_px(views, searched(views, wild))[0][PATCH] < 1).mean() > 0.95  # found: all; without TAIL none


def test_masked_pixels_stay_and_their_depths_do_not_matter(views: list[FittedView], spoiled: np.ndarray) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[28:36, 28:36] = False
    masked, other = [replace(views[0], mask=mask), *views[1:]], spoiled.copy()
    other[0][~mask] = 1e3
    found, changed = searched(masked, spoiled), searched(masked, other)
    assert (found[0] != spoiled[0])[mask].any()
    assert (changed[0] == other[0])[~mask].all()
    assert (changed[0] == found[0])[mask].mean() > 0.99


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(
    unit: float, offset: float, views: list[FittedView], spoiled: np.ndarray
) -> None:
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    moved = in_another_world(views, turn, shift, unit)
    here, there = searched(views, spoiled), searched(moved, unit * spoiled) / unit
    assert (np.abs(here / there - 1) > 1e-6).mean() < 2e-3  # rounding at a tie
