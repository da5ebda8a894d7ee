"""Reconstructions from photographs of another aspect than the network's: nothing of them is cut away."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plane_scene import PlaneScene
from sample_photographs import FAR, NEAR, sample_cameras, sample_pixels
from standin_model import C0, EXTRA, HEIGHT, OPACITY, SCALES, WIDTH

from gapmes.service.leaving_out.budget import KEEP_ALL
from gapmes.service.network.engine import Engine
from gapmes.service.photographs.images import Photo, fit_view
from gapmes.service.photographs.masks import MASKED
from gapmes.service.photographs.rolled import turned_camera
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.reconstruct import Reconstructor, Scene

ACROSS = 80  # px, of a photograph with 16 : 9 beside the network's 64 x 48
DOWN = 80  # px, of one with 3 : 4; the nearest multiple of 16 to 85.3


@pytest.fixture(scope="module")
def reconstructor(engine: Engine) -> Reconstructor:
    return Reconstructor(engine)


@pytest.fixture(scope="module")
def wide() -> PlaneScene:
    return PlaneScene.make(np.random.default_rng(7), size=(320, 180), turn=0.3)


def reconstructed(reconstructor: Reconstructor, plane: PlaneScene, **options: Any) -> Scene:
    given = {"near": plane.near, "far": plane.far, "budget": KEEP_ALL, **options}
    return reconstructor.reconstruct(plane.images, plane.cameras, **given)


def test_every_pixel_of_the_whole_photograph_is_a_gaussian_on_its_ray(
    reconstructor: Reconstructor, wide: PlaneScene
) -> None:
    scene = reconstructed(reconstructor, wide, fade=0)
    assert {(view.height, view.width) for view in scene.view_cameras} == {(HEIGHT, ACROSS)}
    assert [pixels.shape for pixels in scene.inputs] == [(HEIGHT, ACROSS, 3)] * 3
    # 80 : 48 of 16 : 9
    assert [row["kept_share"] for row in scene.document["crop"]] == pytest.approx([80 * 9 / (48 * 16)] * 3, abs=1e-6)
    count = HEIGHT * ACROSS
    assert len(scene.gaussians) == 3 * (count + EXTRA)
    depth = math.sqrt(wide.near * wide.far)
    centres = np.stack(np.meshgrid(np.arange(ACROSS) + 0.5, np.arange(HEIGHT) + 0.5), -1).reshape(-1, 2)
    for index, camera in enumerate(scene.view_cameras):
        own = scene.gaussians[index * count : (index + 1) * count]
        pixels, z = camera.project(own.means)
        np.testing.assert_allclose(z, depth, rtol=2e-6)
        np.testing.assert_allclose(pixels, centres, atol=1e-3)
        view = fit_view(Photo(wide.images[index]), wide.cameras[index], HEIGHT, ACROSS)
        colours = 0.5 + C0 * own.harmonics[:, 0]
        np.testing.assert_allclose(colours, view.image.transpose(1, 2, 0).reshape(-1, 3), atol=1e-5)
        np.testing.assert_allclose(own.opacities, OPACITY, rtol=1e-6)
        # as much smaller as the pixel is: by the root of its share of the network's
        expected = np.sort(SCALES) * depth * math.sqrt(HEIGHT * WIDTH / count)
        np.testing.assert_allclose(np.sort(own.scales, axis=1), np.tile(expected, (count, 1)), rtol=1e-5)


def test_tall_photographs_too(reconstructor: Reconstructor) -> None:
    tall = PlaneScene.make(np.random.default_rng(7), size=(240, 320), turn=0.3)
    scene = reconstructed(reconstructor, tall, fade=0)
    assert {(view.height, view.width) for view in scene.view_cameras} == {(DOWN, WIDTH)}
    assert len(scene.gaussians) == 3 * (DOWN * WIDTH + EXTRA)


def test_not_whole_they_are_cropped(reconstructor: Reconstructor, wide: PlaneScene) -> None:
    """A wide photograph gives what its middle alone gives, but for the filter at the middle's border."""
    cropped = PlaneScene(
        tuple(camera.cropped(40, 0, 240, 180) for camera in wide.cameras),
        tuple(image[:, 40:280] for image in wide.images),
        wide.near,
        wide.far,
    )
    found, expected = (
        reconstructed(reconstructor, plane, whole=whole, fade=0) for plane, whole in ((wide, False), (cropped, True))
    )
    assert {(view.height, view.width) for view in found.view_cameras} == {(HEIGHT, WIDTH)}
    for name in ("means", "scales", "rotations_wxyz", "opacities"):
        np.testing.assert_array_equal(getattr(found.gaussians, name), getattr(expected.gaussians, name))
    for one, other in zip(found.inputs, expected.inputs, strict=True):
        np.testing.assert_array_equal(one[:, 3:-3], other[:, 3:-3])


def test_the_margins_are_shown_again(reconstructor: Reconstructor, wide: PlaneScene) -> None:
    """A view between the inputs beyond what their middles show, mended and not; cropped, it is torn there."""
    between = PlaneScene.make(np.random.default_rng(7), size=(320, 180), turn=0.3).cameras[1]
    two = PlaneScene(wide.cameras[::2], wide.images[::2], wide.near, wide.far)
    target = fit_view(Photo(wide.images[1]), between, HEIGHT, ACROSS)
    figures = {}
    for whole in (True, False):
        scene = reconstructed(reconstructor, two, whole=whole)
        picture = scene.render(target.camera).rgb.transpose(2, 0, 1).clip(0, 1)
        figures[whole] = psnr(picture, target.image)
    assert figures[True] > figures[False] + 1, figures


def test_what_else_a_scene_has_fits_its_shape(reconstructor: Reconstructor, wide: PlaneScene) -> None:
    """Detail, predictions of each view from the others, patches and masks."""
    plain, fine = (reconstructed(reconstructor, wide, detail=detail) for detail in (1, 2))
    assert {(view.height, view.width) for view in fine.view_cameras} == {(2 * HEIGHT, 2 * ACROSS)}
    patches = (HEIGHT // 16) * (WIDTH // 16)
    assert [len(digits) for digits in plain.document["routing"]["maps"]["experts"]] == [patches] * 3
    assert fine.document["routing"] == plain.document["routing"]
    rows = plain.document["check"]["leave_one_out"]
    assert [row["from"] for row in rows] == [[1, 2], [0, 2], [0, 1]]
    assert min(row["psnr"] for row in rows) > 10
    assert plain.document["model"]["width"] == WIDTH


def test_masked_pixels_of_the_margins_are_left_out_and_counted(reconstructor: Reconstructor, wide: PlaneScene) -> None:
    alpha = np.full((180, 320, 1), 255, np.uint8)
    alpha[:, :40] = 0  # an eighth: ten of the 80 columns, which are 9/8 px of the 16 : 9 apart
    masked = PlaneScene(wide.cameras, (np.dstack([wide.images[0], alpha]), *wide.images[1:]), wide.near, wide.far)
    scene = reconstructed(reconstructor, masked, fade=0)
    hidden = np.count_nonzero(scene.inputs[0][..., 3] == 0)
    assert 6 * HEIGHT <= hidden <= 10 * HEIGHT
    dropped = {row["reason"]: row["count"] for row in scene.document["dropped"]}
    # the reduced picture has no patch that is masked throughout: all are the mask's own pixels
    assert dropped[MASKED] == hidden


@pytest.mark.parametrize(("size", "kept"), [((640, 360), slice(222, 230)), ((720, 360), slice(210, 219))])
def test_a_strip_as_wide_as_a_pixel_of_the_scene_stays(
    reconstructor: Reconstructor, size: tuple[int, int], kept: slice
) -> None:
    """It fills less than half of the network's wider pixels, so that no pixel of theirs is kept."""
    plane = PlaneScene.make(np.random.default_rng(7), size=size, turn=0.3)
    alpha = np.zeros((size[1], size[0], 1), np.uint8)
    alpha[:, kept] = 255
    masked = PlaneScene(plane.cameras, (np.dstack([plane.images[0], alpha]), *plane.images[1:]), plane.near, plane.far)
    scene = reconstructed(reconstructor, masked, fade=0, leave_one_out=0)
    shown = scene.inputs[0][..., 3] > 0
    assert shown.sum() == HEIGHT  # a column
    count = shown.size
    assert len(scene.gaussians) >= 2 * count + HEIGHT
    own = scene.gaussians[:HEIGHT]
    colours = 0.5 + C0 * own.harmonics[:, 0]
    np.testing.assert_allclose(colours, scene.inputs[0][shown][:, :3] / 255, atol=0.5 / 255 + 1e-5)
    np.testing.assert_allclose(own.opacities, OPACITY, rtol=1e-6)


def test_a_wide_photograph_on_its_side_is_as_good(shipped: Reconstructor) -> None:
    """One of two photographs of 4 : 3 was taken with the camera on its side: the scene is that of upright ones."""
    cameras = [camera.cropped(0, 32, 256, 192) for camera in sample_cameras((1, 5, 3))]
    images = [sample_pixels(index)[32:224] for index in (1, 5, 3)]
    lying = np.ascontiguousarray(np.rot90(images[1]))
    target = fit_view(Photo(images[2]), cameras[2], 256, 336)
    figures = []
    for image, camera in ((images[1], cameras[1]), (lying, turned_camera(cameras[1], 1))):
        scene = shipped.reconstruct([images[0], image], [cameras[0], camera], near=NEAR, far=FAR)
        picture = scene.render(target.camera).rgb.transpose(2, 0, 1).clip(0, 1)
        figures.append(psnr(picture, target.image))
    assert [(view.height, view.width) for view in scene.view_cameras] == [(256, 336), (336, 256)]
    assert [row["turned_degrees"] for row in scene.document["crop"]] == [0, 270]
    assert scene.inputs[1].shape == (336, 256, 3)
    assert figures[1] == pytest.approx(figures[0], abs=0.1), figures
    assert figures[0] > 24, figures


@pytest.fixture(scope="module")
def shipped() -> Reconstructor:
    return Reconstructor(threads=2)
