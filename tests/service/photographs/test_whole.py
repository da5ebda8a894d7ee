"""The shape of a scene for photographs of any aspect, and its reduction to the shape that the network takes."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from plane_scene import PlaneScene

from gapmes.service.cameras.camera import Camera
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.photographs.whole import Shape, squeezed, view_shapes

SQUARE = (256, 256)


def camera(width: int, height: int) -> Camera:
    return Camera.make(width, height, width, width, width / 2, height / 2, np.eye(4))


@pytest.mark.parametrize(
    ("sizes", "network", "shape"),
    [
        ([(512, 512)], SQUARE, (256, 256)),
        ([(511, 512)], SQUARE, (256, 256)),
        ([(512, 383)], SQUARE, (256, 336)),
        ([(600, 400)], SQUARE, (256, 384)),
        ([(287, 512)], SQUARE, (464, 256)),
        ([(3000, 1000)], SQUARE, (256, 512)),  # longer than twice as wide: cropped to that
        ([(100, 1000)], SQUARE, (512, 256)),
        ([(400, 300), (300, 400)], SQUARE, (256, 256)),  # both lose a quarter
        ([(400, 300), (400, 300), (1600, 900)], SQUARE, (256, 400)),  # sqrt(4/3 * 16/9) = 1.54; nearest: 394
        ([(400, 300)], (48, 64), (48, 64)),
        ([(300, 300)], (48, 64), (64, 64)),
        ([(1600, 900)], (48, 64), (48, 80)),
    ],
)
def test_shapes(sizes: list[tuple[int, int]], network: Shape, shape: Shape) -> None:
    cameras = [camera(*size) for size in sizes]
    assert view_shapes(cameras, [0] * len(cameras), network) == [shape] * len(cameras)


def test_a_photograph_that_lay_on_its_side_has_the_shape_of_its_neighbours_after_it_is_turned() -> None:
    cameras = [camera(400, 300), camera(300, 400), camera(400, 300)]
    assert view_shapes(cameras, [0, 1, 2], SQUARE) == [(256, 336), (336, 256), (256, 336)]
    assert view_shapes(cameras, [0, 3, 0], SQUARE) == [(256, 336), (336, 256), (256, 336)]


@pytest.mark.parametrize("network", [(256, 256), (256, 336), (128, 128), (48, 64)])
def test_nothing_is_smaller_than_the_network_and_little_is_cropped(network: Shape) -> None:
    rng = np.random.default_rng(3)
    height, width = network
    for aspect in np.exp(rng.uniform(np.log(width / height / 2), np.log(width / height * 2), 200)):
        one = camera(round(4000 * aspect), 4000)
        ((rows, columns),) = view_shapes([one], [0], network)
        assert min(rows - height, columns - width) == 0
        assert rows % 16 == columns % 16 == 0
        kept = min(columns / rows * one.height / one.width, rows / columns * one.width / one.height)
        assert kept >= 1 - 8.1 / min(network)  # the nearest multiple of 16 px is at most 8 px away


def wide(seed: int = 4) -> FittedView:
    plane = PlaneScene.make(np.random.default_rng(seed), size=(320, 180), turn=0.3)
    return fit_view(Photo(plane.images[0]), plane.cameras[0], 128, 224)


def test_a_reduced_picture_keeps_every_point_at_its_ray() -> None:
    """A picture that is linear in column and row is one of the network's columns and rows, away from its borders."""
    view = wide()
    row, column = np.mgrid[: view.camera.height, : view.camera.width] + 0.5
    levels = np.stack([column / 224, row / 128, (column + row) / 352]).astype(np.float32)
    found = squeezed(FittedView(levels, None, view.camera, 1.0), 128, 128)
    row, column = np.mgrid[:128, :128] + 0.5
    expected = np.stack([column / 128, row / 128, (column * 224 / 128 + row) / 352])
    inner = (slice(None), slice(8, -8), slice(8, -8))
    assert np.abs(found.image - expected)[inner].max() < 1.5 / 255  # rounded to 8 bits before and after
    picture = Image.fromarray(FittedView(levels, None, view.camera, 1.0).pixels())
    whole = np.asarray(picture.resize((128, 128), Image.Resampling.LANCZOS)).transpose(2, 0, 1)
    np.testing.assert_array_equal(np.rint(255 * found.image), whole)  # up to the border
    pixels = np.array([[3.5, 100.25], [127.0, 1.0]])
    np.testing.assert_allclose(
        found.camera.rays(pixels), view.camera.rays(pixels * [224 / 128, 1.0]), rtol=1e-12, atol=1e-12
    )


def test_a_mask_is_reduced_with_its_picture() -> None:
    view = wide()
    mask = np.ones(view.image.shape[1:], np.bool_)
    mask[:, 112:] = False
    found = squeezed(FittedView(view.image, mask, view.camera, 1.0), 128, 128)
    assert found.mask is not None
    assert found.mask[:, :64].all()
    assert not found.mask[:, 64:].any()
    assert not found.image[:, ~found.mask].any()
    assert squeezed(FittedView(view.image, np.ones_like(mask), view.camera, 1.0), 128, 128).mask is None


def test_a_picture_of_the_networks_shape_is_itself() -> None:
    view = wide()
    assert squeezed(view, 128, 224) is view
