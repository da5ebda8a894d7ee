"""What an opacity does to a picture, against finite differences of the float64 reference."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from splat_cases import camera, dots, moved, scene

from gapmes.service.camera import Camera
from gapmes.service.errors import InputError
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, leverage, render, render_reference

BEHIND = (0.2, 0.9, 0.4)


def change_by_opacity(gaussians: Gaussians, view: Camera, i: int, step: float) -> np.ndarray:
    """(H, W, 3) dC/do of one Gaussian: a picture is linear in each opacity, apart from the cuts."""
    before = render_reference(gaussians, view, background=BEHIND).rgb
    opacities = gaussians.opacities.copy()
    opacities[i] -= np.float32(step)
    after = render_reference(moved(gaussians, opacities=opacities), view, background=BEHIND).rgb
    return (after - before) / (float(opacities[i]) - float(gaussians.opacities[i]))


def case(count: int, seed: int, degree: int = 0) -> tuple[Gaussians, Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Gaussians, camera, their picture, a residual and the counted pixels, in more than one tile each way."""
    rng = np.random.default_rng(seed)
    view = camera(44, 37)
    gaussians = scene(count, seed, degree)
    gaussians = moved(gaussians, opacities=np.maximum(gaussians.opacities, np.float32(0.02)))
    picture = render(gaussians, view, background=BEHIND).rgb
    return gaussians, view, picture, rng.normal(size=picture.shape), rng.uniform(size=picture.shape[:2]) < 0.8


@pytest.mark.parametrize(("count", "seed", "degree"), [(12, 1, 0), (60, 2, 2), (90, 3, 0)])
def test_slopes_and_moves_are_those_of_the_reference(count: int, seed: int, degree: int) -> None:
    gaussians, view, picture, residual, counted = case(count, seed, degree)
    found = leverage(gaussians, view, picture, residual, counted)
    compared = 0
    for i in range(count):
        change, closer = (change_by_opacity(gaussians, view, i, step)[counted] for step in (2.0**-11, 2.0**-13))
        if np.abs(change - closer).max() > 1e-9:
            continue  # a pixel went over a cut
        compared += 1
        # Found: at most 4e-7 of the largest slope and move of the scene; float32 adds up some hundred pixels.
        assert found.slope[i] == pytest.approx((residual[counted] * change).sum(), rel=1e-5, abs=1e-4)
        assert found.moved[i] == pytest.approx((change**2).sum(), rel=1e-5, abs=1e-5)
    assert compared >= 0.9 * count
    assert (found.moved > 0).sum() >= 0.6 * count


def test_a_held_alpha_moves_nothing() -> None:
    """An opacity of 1 is held at 0.99 where the Gaussian is at its height, and moves the pixels around."""
    view = camera(17, 17)
    one = dots([[0.0, 0.0, 2.0]], [1.0], [0.9, 0.5, 0.1], scale=0.6)
    picture = render(one, view).rgb
    everywhere = np.ones((17, 17), bool)
    height = picture[..., 0] / np.float32(0.9)
    assert (height >= 0.9899).any()
    free = height < 0.9899
    found = leverage(one, view, picture, picture, everywhere)
    assert found.slope[0] == pytest.approx((picture[free] ** 2).sum(), rel=1e-5)
    assert leverage(one, view, picture, picture, ~free).moved[0] == 0.0


def test_what_is_not_drawn_has_no_leverage() -> None:
    view = camera(24, 24)
    gaussians = dots([[0, 0, 2], [0, 0, -2], [0, 0, 3], [9, 0, 2]], [0.5, 0.5, 0.003, 0.5], 0.7, scale=0.1)
    picture = render(gaussians, view).rgb
    found = leverage(gaussians, view, picture, np.ones_like(picture), np.ones((24, 24), bool))
    assert found.moved[0] > 0
    assert not found.moved[1:].any()
    assert not found.slope[1:].any()
    none = leverage(gaussians, view, picture, np.ones_like(picture), np.zeros((24, 24), bool))
    assert not none.moved.any()
    empty = gaussians[np.zeros(4, bool)]
    assert leverage(empty, view, picture, picture, np.ones((24, 24), bool)).slope.shape == (0,)


def test_lists_in_several_batches_go_on_where_the_one_before_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    gaussians, *given = case(90, 3)
    whole = leverage(gaussians, *given)
    module = importlib.import_module("gapmes.service.splat.leverage")
    monkeypatch.setattr(module, "checked_definition", lambda *_: Definition(max_entries=7))
    parts = leverage(gaussians, *given)
    np.testing.assert_allclose(parts.slope, whole.slope, rtol=1e-5, atol=1e-6 * np.abs(whole.slope).max())
    np.testing.assert_allclose(parts.moved, whole.moved, rtol=1e-5)


def test_the_order_of_the_gaussians_does_not_matter() -> None:
    gaussians, *given = case(90, 4)
    order = np.random.default_rng(0).permutation(90)
    found, other = leverage(gaussians, *given), leverage(gaussians[order], *given)
    assert (other.slope == found.slope[order]).all()
    assert (other.moved == found.moved[order]).all()


def test_a_near_plane_that_makes_no_sense_is_refused() -> None:
    gaussians, *given = case(3, 0)
    with pytest.raises(InputError, match="near"):
        leverage(gaussians, *given, near=-1.0)
