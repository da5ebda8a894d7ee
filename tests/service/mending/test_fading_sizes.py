"""Photographs at two sizes: each has its share of the sums, and overfitting to one pixel grid is corrected."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plane_views import SIDE, error, floaters, joined, on_the_plane, plane_views

from gapmes.service.gaussians import Gaussians
from gapmes.service.harmonics import C0
from gapmes.service.mending.fading import OWN_SHARE, RESIZED_ROUNDS, RESIZED_SHARE, faded
from gapmes.service.mending.targets import Targets
from gapmes.service.photographs.images import FittedView, PackedView
from gapmes.service.splat import Leverage, render


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    """The first and the last photograph of the plane."""
    return plane_views()[::2]


@pytest.fixture(scope="module")
def larger() -> list[FittedView]:
    """The same with twice the pixels in each direction."""
    return plane_views(2 * SIDE)[::2]


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> Gaussians:
    return joined(*(on_the_plane(view) for view in views), floaters(40))


@pytest.fixture
def shares(monkeypatch: pytest.MonkeyPatch) -> dict[int, float]:
    """By the width of the views that are compared: the weight of a pixel, the last that was asked for."""
    found: dict[int, float] = {}
    real = Targets.sums

    def recorded(targets: Targets, *rest: Any, share: float = 1.0, **options: Any) -> Leverage:
        found.update({view.camera.width: share for view in targets.views})
        return real(targets, *rest, share=share, **options)

    monkeypatch.setattr(Targets, "sums", recorded)
    return found


def packed(views: list[FittedView]) -> list[PackedView]:
    return [PackedView.of(view) for view in views]


@pytest.mark.parametrize("passes", [1, 2])
def test_the_same_size_again_changes_nothing(passes: int, views: list[FittedView], spoiled: Gaussians) -> None:
    """Both shares of the same sums are the sums: only rounding differs, of weights in float32. With more passes the two
    are first compared, and remember what was covered, at different times."""
    once, again = (faded(spoiled, views, passes, resized=given).gaussians for given in ((), packed(views)))
    assert np.abs(once.opacities - again.opacities).max() < 2e-5  # found: 9e-7
    assert C0 * np.abs(once.harmonics - again.harmonics).max() < 2e-5  # found: 3e-7


def test_a_scene_that_shows_both_sizes_stays(
    views: list[FittedView], larger: list[FittedView], spoiled: Gaussians
) -> None:
    """But for the rounding to 8 bits: even floaters, since the photographs are pictures of the very scene."""

    def photographed(view: FittedView) -> FittedView:
        drawn = render(spoiled, view.camera)
        shown = np.clip(drawn.rgb / np.maximum(drawn.alpha, 0.001)[..., None], 0, 1)
        return replace(view, image=(np.rint(255 * shown) / np.float32(255)).transpose(2, 0, 1).astype(np.float32))

    given, resized = ([photographed(view) for view in each] for each in (views, larger))
    result = faded(spoiled, given, resized=packed(resized))
    assert result.halved == 0
    assert np.abs(result.gaussians.opacities - spoiled.opacities).max() < 0.04  # found: 0.011
    assert C0 * np.abs(result.gaussians.harmonics - spoiled.harmonics).max() < 0.02  # found: 0.005


def test_pictures_of_twice_the_size_gain_and_new_views_of_its_own_lose_nothing(
    views: list[FittedView], larger: list[FittedView], spoiled: Gaussians
) -> None:
    alone, both = (faded(spoiled, views, resized=given).gaussians for given in ((), packed(larger)))
    middle, twice = (plane_views(side)[1] for side in (SIDE, 2 * SIDE))  # kept back
    for view in (*larger, twice):
        assert error(both, view) > error(alone, view) + 0.5  # found: 0.8, 1.0, 0.65 dB
    assert error(both, middle) > error(alone, middle) - 0.1  # found: 0.03 dB more


@pytest.mark.parametrize("passes", [1, 2, 4, 8])
def test_the_last_rounds_alone_look_at_the_other_size(
    passes: int, views: list[FittedView], larger: list[FittedView], spoiled: Gaussians, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def recorded(targets: Targets, *rest: object, **options: object) -> Leverage:
        drawn.extend({view.camera.width for view in targets.views})
        return real(targets, *rest, **options)

    real = Targets.sums
    monkeypatch.setattr(Targets, "sums", recorded)
    faded(spoiled, views, passes, resized=packed(larger))
    rounds = [1 + (number > passes - RESIZED_ROUNDS) for number in range(passes + 1)]
    assert drawn == [width for sizes in rounds for width in (SIDE, 2 * SIDE)[:sizes]]
    assert sum(rounds) == passes + 1 + min(RESIZED_ROUNDS, passes + 1)


@pytest.mark.parametrize(
    ("finer", "steps", "own"),
    [
        (2, (0.4, 1), 0),
        (2, (1, 1), 0),
        (2, (1.5, 1.5), 0.5),
        (2, (0.5, 1.5), 0.25),
        (2, (2, 2), 1),
        (2, (9, 2), 1),
        (3, (2, 2), 0.5),
        (3, (3, 5), 1),
    ],
)
def test_the_larger_size_weighs_more_where_its_pixels_are_the_photographs_own(
    finer: int,
    steps: tuple[float, float],
    own: float,
    views: list[FittedView],
    spoiled: Gaussians,
    shares: dict[int, float],
) -> None:
    """At step 1 a view shows all pixels of its photograph, so that the larger size is enlarged; at step `finer` that
    shows them all."""
    given = [replace(view, step=step) for view, step in zip(views, steps, strict=True)]
    faded(spoiled, given, 1, resized=packed(plane_views(finer * SIDE)[::2]))
    expected = RESIZED_SHARE + own * (OWN_SHARE - RESIZED_SHARE)
    assert shares == {SIDE: pytest.approx(1 - expected), finer * SIDE: pytest.approx(expected / finer**2)}  # by area


@pytest.mark.parametrize("step", [0.5, 0.75, 4.0])
def test_a_smaller_size_has_the_same_weight_of_any_photograph(
    step: float, views: list[FittedView], larger: list[FittedView], spoiled: Gaussians, shares: dict[int, float]
) -> None:
    faded(spoiled, [replace(view, step=step) for view in larger], 1, resized=packed(views))
    assert shares == {2 * SIDE: 1 - RESIZED_SHARE, SIDE: pytest.approx(4 * RESIZED_SHARE)}
