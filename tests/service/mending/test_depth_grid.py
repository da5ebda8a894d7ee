"""Depths on a finer grid: exact on a plane, never across an edge, and back again unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from plane_views import SIDE, plane_depths, plane_views

from gapmes.service.matching.coarse_views import pixel_grid
from gapmes.service.mending.depth_grid import FinerPixels, coarser_depths, finer_depths


@pytest.mark.parametrize("k", [2, 3])
def test_a_plane_is_met_on_the_rays_of_the_finer_pixels(k: int) -> None:
    for view, depth in zip(plane_views(), plane_depths(plane_views()), strict=True):
        large = view.camera.resized(k * SIDE, k * SIDE)
        points = large.unproject(pixel_grid((k * SIDE, k * SIDE)), finer_depths(depth, k * SIDE, k * SIDE).ravel())
        height = points[:, 2].reshape(k * SIDE, k * SIDE)[k:-k, k:-k]
        assert np.ptp(height) < 1e-9  # found: 4e-15; at the border the slope is 0


def test_an_edge_stays_one() -> None:
    depth = np.where(np.arange(8) < 4, 1.0, 3.0) * np.ones((6, 1))
    assert (finer_depths(depth, 12, 16) == np.where(np.arange(16) < 8, 1.0, 3.0)).all()
    peak = np.where(np.arange(7) == 3, 1.0, 3.0) * np.ones((5, 1))
    assert (np.unique(finer_depths(peak, 10, 14)) == np.unique(peak)).all()


def test_of_two_slopes_the_smaller_one_is_taken() -> None:
    inverse = np.array([1.0, 1.1, 1.5, 1.9]) * np.ones((3, 1))
    fine = 1 / finer_depths(1 / inverse, 6, 8)
    assert fine[0] == pytest.approx([1.0, 1.0, 1.075, 1.125, 1.4, 1.6, 1.9, 1.9])


@pytest.mark.parametrize("k", [2, 3])
def test_the_way_back_undoes_it(k: int) -> None:
    """A pixel's finer ones lie about it evenly, on a plane."""
    depths = np.random.default_rng(1).uniform(0.1, 50, (2, 9, 7))
    back = coarser_depths(np.stack([finer_depths(depth, 9 * k, 7 * k) for depth in depths]), k)
    assert np.abs(back / depths - 1).max() < 1e-12


def test_the_way_back_takes_the_median_of_inverse_depths() -> None:
    square = np.array([[[1.0, 2.0], [4.0, 100.0]]])
    assert coarser_depths(square, 2)[0, 0, 0] == pytest.approx(2 / (1 / 2 + 1 / 4))


def test_finer_pixels_tile_their_pixel() -> None:
    assert FinerPixels.of(4, 4).step == pytest.approx([0.0] * 4)
    assert FinerPixels.of(1, 2).step == pytest.approx([-0.25, 0.25])
    assert FinerPixels.of(1, 3).step == pytest.approx([-1 / 3, 0.0, 1 / 3])


@pytest.mark.parametrize(("count", "finer"), [(256, 336), (256, 448), (16, 17), (3, 7), (1, 5)])
def test_finer_pixels_span_the_same_as_the_coarse_ones(count: int, finer: int) -> None:
    """At any ratio each centre lies within its pixel, and their distances are even."""
    pixels = FinerPixels.of(count, finer)
    assert set(pixels.coarse) == set(range(count))
    assert np.abs(pixels.step).max() <= 0.5
    centres = pixels.coarse + 0.5 + pixels.step
    np.testing.assert_allclose(centres, (np.arange(finer) + 0.5) / finer * count, rtol=1e-14)


def test_at_a_broken_ratio_a_plane_is_met_too() -> None:
    for view, depth in zip(plane_views(), plane_depths(plane_views()), strict=True):
        large = view.camera.resized(SIDE, SIDE * 21 // 16)
        points = large.unproject(pixel_grid((large.height, SIDE)), finer_depths(depth, large.height, SIDE).ravel())
        assert np.ptp(points[:, 2].reshape(large.height, SIDE)[2:-2, 1:-1]) < 1e-9
