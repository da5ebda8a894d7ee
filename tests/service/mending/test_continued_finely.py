"""Planes continued between the pixels: errors below a pixel vanish as well, and masked regions have no influence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import PATCH, SIDE, plane_depths, plane_views, with_wrong_patch

from gapmes.service.mending.continued import continued
from gapmes.service.mending.continued_finely import FINER, _enlarged, continued_finely
from gapmes.service.photographs.images import FittedView


@pytest.fixture(scope="module")
def views() -> list[FittedView]:
    return plane_views()[:2]


@pytest.fixture(scope="module")
def spoiled(views: list[FittedView]) -> np.ndarray:
    return with_wrong_patch(views, 1.2)


def test_a_wrong_patch_returns_to_the_plane(views: list[FittedView], spoiled: np.ndarray) -> None:
    wrong = np.abs(continued_finely(views, spoiled)[0] / plane_depths(views)[0] - 1)[PATCH]
    assert (wrong < 0.01).mean() > 0.95


def test_an_enlarged_photograph_is_the_same_picture(views: list[FittedView]) -> None:
    """The mean of the finer pixels is nearly the pixel, and the camera sees it at the same place."""
    for view in views:
        large = _enlarged(view)
        assert large.image.shape == (3, FINER * SIDE, FINER * SIDE)
        means = large.image.reshape(3, SIDE, FINER, SIDE, FINER).mean(axis=(2, 4))
        assert np.abs(means - view.image)[:, 2:-2, 2:-2].max() < 0.15
        assert np.abs(means - view.image).mean() < 0.01
        point = view.camera.unproject(np.array([[10.0, 20.0]]), np.array([3.0]))
        assert large.camera.project(point)[0][0] == pytest.approx([FINER * 10.0, FINER * 20.0])
        assert large.step == view.step / FINER
        assert large.image.min() >= 0
        assert large.image.max() <= 1


def test_masked_pixels_stay(views: list[FittedView], spoiled: np.ndarray) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[28:36, 28:36] = False
    masked = [replace(views[0], mask=mask), views[1]]
    found, rest = continued_finely(masked, spoiled)[0], continued(masked, spoiled)[0]
    assert np.abs(found / spoiled[0] - 1)[~mask].max() < 1e-12
    assert (found != spoiled[0])[mask].any()
    assert np.abs(found / rest - 1)[PATCH].mean() < 0.02


def test_without_a_confirmed_pixel_depths_stay(views: list[FittedView]) -> None:
    depths = plane_depths(views) * np.random.default_rng(3).uniform(0.5, 2, (2, SIDE, SIDE))
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in views]
    assert np.abs(continued_finely(flat, depths) / depths - 1).max() < 1e-12


def test_what_is_off_by_less_than_a_pixel_returns_as_well(views: list[FittedView]) -> None:
    """0.7 px of parallax: confirmed at the pixels, where nothing moves, but not between them."""
    truth = plane_depths(views)
    depths = truth.copy()
    depths[0][PATCH] *= 1.06
    at_pixels, finely = (
        np.abs(found[0] / truth[0] - 1)[PATCH] for found in (continued(views, depths), continued_finely(views, depths))
    )
    assert (at_pixels > 0.01).mean() > 0.95  # found: 0.996
    assert (finely < 0.01).mean() > 0.95  # found: all


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_nothing_bleeds_in_from_behind_a_mask(share: float, views: list[FittedView]) -> None:
    """A flat thing has no texture after it is enlarged either, whatever the colour of what its mask hides."""
    mask = np.random.default_rng(1).random((SIDE, SIDE)) < share
    for hidden in (0.0, 1.0):
        image = np.where(mask, np.float32(0.8), np.float32(hidden)) * np.ones((3, 1, 1), np.float32)
        large = _enlarged(replace(views[0], image=image, mask=mask))
        assert large.mask is not None
        assert (large.mask.reshape(SIDE, FINER, SIDE, FINER).transpose(0, 2, 1, 3) == mask[..., None, None]).all()
        assert np.abs(large.image[:, large.mask] - 0.8).max() < 1e-6  # found: 1.3e-7, the rounding of float32
        assert (large.image[:, ~large.mask] == 0).all()
