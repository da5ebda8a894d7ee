"""A scene finer than the network's grid: the surfaces of its Gaussians, and their colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import PlaneScene
from plane_views import SIDE, on_the_plane, plane_depths

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.world_frame import WorldFrame
from gapmes.service.gaussians import joined
from gapmes.service.harmonics import C0
from gapmes.service.mending.after_network import placed
from gapmes.service.mending.detail import finer
from gapmes.service.network.engine import Arrays
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.photographs.masks import MASKED
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.splat import render

EXTRA = 5  # Gaussians that belong to no pixel


@pytest.fixture(scope="module")
def frame(views: list[FittedView]) -> WorldFrame:
    return WorldFrame.of([view.camera for view in views], DepthRange(2.0, 8.0, "given"))


def resampled(size: int) -> list[FittedView]:
    """The photographs of `plane_views` at another size, from photographs that have the pixels for it."""
    scene = PlaneScene.make(np.random.default_rng(5), turn=0.3)
    return [fit_view(Photo(i), c, size, size) for i, c in zip(scene.images, scene.cameras, strict=True)]


def outputs(views: list[FittedView], frame: WorldFrame, depths: np.ndarray | None = None) -> Arrays:
    """A network's, whose Gaussians lie at `depths` (V, H, W) in the world's units; without, on the plane."""
    depths = plane_depths(views) if depths is None else depths
    grid = np.stack(np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5), -1).reshape(-1, 2)
    world = joined(*(on_the_plane(view) for view in views), on_the_plane(views[0])[:EXTRA])
    means = world.means.copy()
    for index, view in enumerate(views):
        means[index * SIDE**2 : (index + 1) * SIDE**2] = view.camera.unproject(grid, depths[index].ravel())
    return {
        "means": ((means - frame.origin) @ frame.rotation / frame.unit).astype(np.float32),
        "scales": world.scales / np.float32(frame.unit),
        "rotations_wxyz": world.rotations_wxyz,
        "opacities": np.linspace(0.1, 0.9, len(means), dtype=np.float32),
        "harmonics": world.harmonics,
        "depth": (depths / frame.unit).astype(np.float32),
        "confidence": np.linspace(0, 1, depths.size, dtype=np.float32).reshape(depths.shape),
        "route_margin": np.ones((len(views), 4), np.float32),
    }


@pytest.mark.parametrize("k", [2, 3])
def test_gaussians_of_a_plane_lie_on_it_and_on_the_fine_pixels_rays(
    views: list[FittedView], frame: WorldFrame, k: int
) -> None:
    """Inverse depth is linear in a plane's picture, so that differences to neighbours continue it without error."""
    fine = resampled(k * SIDE)
    found = finer(outputs(views, frame), frame, views, fine)
    count = k * k * SIDE**2
    assert found["depth"].shape == (3, k * SIDE, k * SIDE)
    grid = np.stack(np.meshgrid(np.arange(k * SIDE) + 0.5, np.arange(k * SIDE) + 0.5), -1).reshape(-1, 2)
    inner = np.zeros((k * SIDE, k * SIDE), bool)
    inner[k:-k, k:-k] = True
    for index, view in enumerate(fine):
        means = frame.origin + found["means"][index * count : (index + 1) * count] @ frame.rotation.T * frame.unit
        pixels, z = view.camera.project(means)
        np.testing.assert_allclose(pixels, grid, atol=1e-3)  # px; worst 1.4e-4, of float32 means
        on_plane = (4.0 - view.camera.center[2]) / view.camera.rays(grid)[:, 2]
        np.testing.assert_allclose(z[inner.ravel()], on_plane[inner.ravel()], rtol=2e-6)  # worst 6e-7
        np.testing.assert_allclose(frame.unit * found["depth"][index].ravel(), z, rtol=1e-6)


def test_gaussians_beside_their_ray_and_behind_their_depth_stay_so(views: list[FittedView], frame: WorldFrame) -> None:
    """0.3 px to the right, 0.2 px up, and a tenth farther than the pixel's depth."""
    given = outputs(views, frame)
    grid = np.stack(np.meshgrid(np.arange(SIDE) + 0.8, np.arange(SIDE) + 0.3), -1).reshape(-1, 2)
    for index, (view, depths) in enumerate(zip(views, plane_depths(views), strict=True)):
        world = view.camera.unproject(grid, 1.1 * depths.ravel())
        given["means"][index * SIDE**2 : (index + 1) * SIDE**2] = (world - frame.origin) @ frame.rotation / frame.unit
    fine = resampled(2 * SIDE)
    found = finer(given, frame, views, fine)
    grid = np.stack(np.meshgrid(np.arange(2 * SIDE) + 1.1, np.arange(2 * SIDE) + 0.1), -1).reshape(-1, 2)
    for index, view in enumerate(fine):
        rows = slice(index * 4 * SIDE**2, (index + 1) * 4 * SIDE**2)
        pixels, z = view.camera.project(frame.origin + found["means"][rows] @ frame.rotation.T * frame.unit)
        np.testing.assert_allclose(pixels, grid, atol=1e-3)
        np.testing.assert_allclose(z, 1.1 * frame.unit * found["depth"][index].ravel(), rtol=1e-6)


def test_across_an_edge_every_pixel_keeps_its_own_depth(views: list[FittedView], frame: WorldFrame) -> None:
    """Boards before a wall, one pixel wide and wider: no fine pixel lies between the two."""
    depths = np.full((3, SIDE, SIDE), 6.0)
    depths[:, :, 10] = depths[:, 30:40, 20:31] = 2.5
    found = finer(outputs(views, frame, depths), frame, views, resampled(2 * SIDE))
    np.testing.assert_array_equal(found["depth"], (depths / frame.unit).astype(np.float32).repeat(2, 1).repeat(2, 2))


def test_no_depth_reaches_beyond_its_neighbours(views: list[FittedView], frame: WorldFrame) -> None:
    """Depths of noise over four decades: each fine one lies between the least and the largest of its 3 x 3."""
    depths = 10.0 ** np.random.default_rng(2).uniform(-1, 3, (3, SIDE, SIDE))
    found = frame.unit * finer(outputs(views, frame, depths), frame, views, resampled(2 * SIDE))["depth"]
    padded = np.pad(depths, ((0, 0), (1, 1), (1, 1)), mode="edge")
    about = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2)).reshape(*depths.shape, 9)
    low, high = (limit.repeat(2, 1).repeat(2, 2) for limit in (about.min(-1), about.max(-1)))
    assert (found >= low * (1 - 1e-6)).all()
    assert (found <= high * (1 + 1e-6)).all()
    assert (found != depths.repeat(2, 1).repeat(2, 2)).mean() > 0.1


def test_colours_are_the_fine_photographs_and_their_mean_stays(views: list[FittedView], frame: WorldFrame) -> None:
    given, fine = outputs(views, frame), resampled(2 * SIDE)
    given["harmonics"] = given["harmonics"] + np.float32(0.1)  # as if the network corrected all colours
    found = finer(given, frame, views, fine)
    pixels = 3 * SIDE**2
    shown = 0.5 + C0 * found["harmonics"][: 4 * pixels, 0].reshape(3, SIDE, 2, SIDE, 2, 3)
    before = 0.5 + C0 * given["harmonics"][:pixels, 0].reshape(3, SIDE, SIDE, 3)
    np.testing.assert_allclose(shown.mean(axis=(2, 4)), before, atol=1e-6)
    photographs = np.stack([view.image for view in fine]).transpose(0, 2, 3, 1).reshape(shown.shape)
    above = shown - shown.mean(axis=(2, 4), keepdims=True)
    np.testing.assert_allclose(above, photographs - photographs.mean(axis=(2, 4), keepdims=True), atol=1e-6)
    assert np.abs(above).max() > 0.05


def test_what_else_a_gaussian_has_is_its_pixels(views: list[FittedView], frame: WorldFrame) -> None:
    given = outputs(views, frame)
    found = finer(given, frame, views, resampled(2 * SIDE))
    pixels = 3 * SIDE**2
    of_pixel = np.arange(pixels).reshape(3, SIDE, SIDE).repeat(2, 1).repeat(2, 2).ravel()
    for name in ("opacities", "rotations_wxyz"):
        np.testing.assert_array_equal(found[name][: 4 * pixels], given[name][of_pixel])
    np.testing.assert_array_equal(found["scales"][: 4 * pixels], given["scales"][of_pixel] / 2)
    np.testing.assert_array_equal(found["confidence"].ravel(), given["confidence"].ravel()[of_pixel])
    for name in ("means", "scales", "rotations_wxyz", "opacities", "harmonics"):
        assert len(found[name]) == 4 * pixels + EXTRA
        np.testing.assert_array_equal(found[name][-EXTRA:], given[name][-EXTRA:])
    assert found["route_margin"] is given["route_margin"]


def test_what_a_mask_leaves_out_tells_nothing_of_the_rest(views: list[FittedView], frame: WorldFrame) -> None:
    """The colours of what it keeps at its edge do not depend on what it hides."""
    given, fine = outputs(views, frame), resampled(2 * SIDE)
    mask = np.zeros((2 * SIDE, 2 * SIDE), np.bool_)
    mask[:, : SIDE + 1] = True  # ends within a square
    found = []
    for hidden in (0.0, 1.0):
        masked = [replace(view, image=np.where(mask, view.image, np.float32(hidden)), mask=mask) for view in fine]
        found.append(finer(given, frame, views, masked))
    kept = np.tile(mask.ravel(), 3)
    np.testing.assert_array_equal(*(one["harmonics"][: kept.size][kept] for one in found))
    alike = finer(given, frame, views, [replace(view, image=np.full_like(view.image, 0.7), mask=mask) for view in fine])
    of_pixel = np.arange(3 * SIDE**2).reshape(3, SIDE, SIDE).repeat(2, 1).repeat(2, 2).ravel()
    np.testing.assert_allclose(alike["harmonics"][: kept.size][kept], given["harmonics"][of_pixel][kept], atol=1e-6)
    assert placed(found[0], frame, masked, moved=False).dropped[MASKED] == (~kept).sum()


def test_the_backdrop_has_the_networks_cells_behind_the_farthest_of_the_fine_depths(
    views: list[FittedView], frame: WorldFrame
) -> None:
    given, fine = outputs(views, frame), resampled(2 * SIDE)
    given["depth"][:] = np.float32(4 / frame.unit)  # so that no fine depth is another
    coarse = placed(given, frame, views, moved=True)
    found = placed(finer(given, frame, views, fine), frame, fine, moved=True, coarse=views)
    assert found.added == coarse.added
    assert found.of_pixel.sum() == 12 * SIDE**2
    assert found.around - 12 * SIDE**2 == coarse.around - 3 * SIDE**2
    np.testing.assert_array_equal(found.gaussians.means[-found.added :], coarse.gaussians.means[-coarse.added :])
    moved = finer(given, frame, views, fine)
    # One pixel, of the cell in row 2 and column 4: the 3 x 3 about it stand behind it, not so far that one more would
    moved["depth"][0, 41, 77] *= 1.15
    farther = placed(moved, frame, fine, moved=True, coarse=views)
    cells = slice(12 * SIDE**2, found.around)
    changed = (farther.gaussians.means[cells] != found.gaussians.means[cells]).any(axis=1)
    assert (farther.added, changed.sum()) == (found.added, 9)


def test_larger_pictures_are_sharper(views: list[FittedView], frame: WorldFrame) -> None:
    """A texture with 1.6 px of the network's grid to a wave, drawn from an input's camera at twice its size."""
    fine = [replace(view, image=waves(view)) for view in resampled(2 * SIDE)]
    squares = (3, SIDE, 2, SIDE, 2)
    seen = [
        replace(view, image=larger.image.reshape(squares).mean(axis=(2, 4)))
        for view, larger in zip(views, fine, strict=True)
    ]
    given = outputs(seen, frame)
    figures = []
    for out, grid in ((given, seen), (finer(given, frame, seen, fine), fine)):
        picture = render(placed(out, frame, grid, moved=False).gaussians, fine[1].camera).rgb
        figures.append(psnr(np.clip(picture, 0, 1).transpose(2, 0, 1), fine[1].image))
    assert figures[1] > figures[0] + 2, figures  # 12.1 and 15.0 dB


def waves(view: FittedView) -> np.ndarray:
    """(3, H, W) what the view's camera sees of a texture on the plane."""
    points = on_the_plane(view).means.reshape(*view.image.shape[1:], 3)
    grey = 0.5 + 0.5 * np.sin(78 * points[..., 0]) * np.sin(20 * points[..., 1])
    return np.stack([grey] * 3).astype(np.float32)
