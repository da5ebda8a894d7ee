"""Photographs on the network's grid: paired with their cameras, rotated, cropped, with matching intrinsics."""

from __future__ import annotations

import io

import numpy as np
import pytest
from encoded_pictures import encoded, picture
from PIL import Image, ImageOps

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import ImageError
from gapmes.service.photographs.images import FittedView, PackedView, Photo, decode_image, fit_view, match_photo
from gapmes.service.photographs.upright import upright


def camera(width, height, fx=50.0, fy=55.0, cx=None, cy=None):
    return Camera.make(
        width, height, fx, fy, width / 2 if cx is None else cx, height / 2 if cy is None else cy, np.eye(4)
    )


@pytest.mark.parametrize("orientation", [1, 5, 6, 7, 8])
def test_exif_orientation_is_applied_only_where_the_camera_is_upright(orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    data = encoded(Image.fromarray(picture(64, 36)), "PNG", exif=exif)
    photo = decode_image(data, index=0)
    assert photo.orientation == orientation
    stored, _ = match_photo(photo, camera(64, 36))
    np.testing.assert_array_equal(stored.rgb, picture(64, 36))
    if orientation == 1:
        with pytest.raises(ImageError, match="the aspects differ"):
            match_photo(photo, camera(36, 64), index=0)
        return
    turned, turned_camera = match_photo(photo, camera(72, 128))
    np.testing.assert_array_equal(turned.rgb, np.asarray(ImageOps.exif_transpose(Image.open(io.BytesIO(data)))))
    assert (turned_camera.width, turned_camera.height) == (36, 64)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_is_turned_as_pillow_turns_it(orientation):
    """Pixels of a photograph, and its mask, which has no channels."""
    image = Image.fromarray(picture(64, 36))
    image.getexif()[0x0112] = orientation
    expected = np.asarray(ImageOps.exif_transpose(image))
    np.testing.assert_array_equal(upright(picture(64, 36), orientation), expected)
    np.testing.assert_array_equal(upright(picture(64, 36)[:, :, 0] > 99, orientation), expected[:, :, 0] > 99)


def test_sizes_must_agree_up_to_one_pixel_of_rounding():
    photo = Photo(picture(100, 75))
    for size in ((4032, 3024), (4032, 3000), (1000, 745), (100, 76), (50, 38), (50, 37)):
        _, matched = match_photo(photo, camera(*size, fx=size[0], fy=size[0]))
        assert (matched.width, matched.height) == (100, 75)
        assert matched.fx == pytest.approx(100)
    with pytest.raises(ImageError, match=r"the photograph is 100 x 75 px, its camera 100 x 80 px") as caught:
        match_photo(photo, camera(100, 80), index=4)
    assert caught.value.index == 4


SIZES = [
    ((64, 48), (97, 131)),
    ((256, 256), (287, 512)),
    ((48, 64), (345, 512)),
    ((32, 32), (33, 33)),
    ((80, 48), (40, 37)),
]


@pytest.mark.case("P9")
@pytest.mark.parametrize(("target", "source"), SIZES)
def test_pixel_ray_pixel_through_crop_and_resize(target, source):
    """A point on a pixel's ray of the photograph lands where the crop put that pixel; off-centre, fx != fy."""
    (height, width), (rows, columns) = target, source
    rng = np.random.default_rng(rows)
    given_camera = camera(columns, rows, fx=0.9 * columns, fy=1.3 * rows, cx=0.31 * columns + 0.7, cy=0.62 * rows - 0.2)
    fitted = fit_view(Photo(picture(columns, rows)), given_camera, height, width)
    assert fitted.image.shape == (3, height, width)
    assert fitted.image.dtype == np.float32
    assert (fitted.camera.width, fitted.camera.height) == (width, height)
    pixels = rng.uniform([0, 0], [columns, rows], size=(100, 2))
    landed, _ = fitted.camera.project(given_camera.unproject(pixels, rng.uniform(1, 5, 100)))
    scale = max(width / columns, height / rows)
    expected = (pixels - np.array([columns, rows]) / 2) * scale + np.array([width, height]) / 2
    np.testing.assert_allclose(landed, expected, atol=1e-9)  # asked for: 1e-4
    assert fitted.kept_share == pytest.approx(width * height / scale**2 / (columns * rows))
    assert fitted.step == pytest.approx(1 / scale)


@pytest.mark.case("P9")
@pytest.mark.parametrize(("target", "source"), SIZES)
def test_the_picture_moves_as_the_intrinsics_say(target, source):
    """Pixels that encode their own position: red the column, green the row. Away from the border, where the filter is
    cut off, the resized value is the position that the new intrinsics map to the pixel."""
    (height, width), (rows, columns) = target, source
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    rgb = np.dstack([x * 255 / columns, y * 255 / rows, 0 * x])
    given_camera = camera(columns, rows, fx=0.8 * columns, fy=0.7 * columns, cx=0.4 * columns, cy=0.55 * rows)
    fitted = fit_view(Photo(np.rint(rgb).astype(np.uint8)), given_camera, height, width)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    there = fitted.camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1), np.ones(u.size))
    pixels, _ = given_camera.project(there)
    inner = (np.abs(pixels / [columns, rows] - 0.5) < 0.5 - 4 / min(rows, columns)).all(axis=1)
    found = fitted.image[:2].reshape(2, -1).T * [columns, rows]
    error = (found - pixels)[inner]
    # 8 bits per side quantise twice: half a level of up to columns / 255 px each time; the mean has no such error.
    assert np.abs(error).max() <= 1.05 * max(rows, columns) / 255
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.03)  # a corner off by half a pixel shows 0.5


def test_masked_colours_do_not_bleed_in():
    rgb = np.full((90, 120, 3), 200, np.uint8)
    rgb[:, :50] = 0
    mask = np.zeros((90, 120), bool)
    mask[:, 50:] = True
    fitted = fit_view(Photo(rgb, mask), camera(120, 90), 48, 64)
    assert not fitted.mask[:, :26].any()
    assert fitted.mask[:, 27:].all()
    assert np.abs(fitted.image[:, fitted.mask] * 255 - 200).max() <= 1.01  # rounding of the weighted colours
    assert (fitted.image[:, ~fitted.mask] == 0).all()


def test_arrays_are_checked():
    with pytest.raises(ImageError, match=r"float64 of shape \(40, 40, 3\)"):
        Photo.from_array(np.zeros((40, 40, 3)), index=0)
    with pytest.raises(ImageError, match=r"shape \(40, 40\)"):
        Photo.from_array(np.zeros((40, 40), np.uint8), index=0)
    with pytest.raises(ImageError, match="at least 32"):
        Photo.from_array(np.zeros((40, 4, 3), np.uint8), index=0)


CAMERA = Camera.make(32, 24, 30.0, 30.0, 16.0, 12.0, np.eye(4))


@pytest.mark.parametrize("masked", [False, True])
def test_a_packed_view_shows_the_same(masked):
    rng = np.random.default_rng(8)
    image = (rng.integers(0, 256, (3, 24, 32)) / np.float32(255)).astype(np.float32)
    view = FittedView(image, rng.random((24, 32)) < 0.5 if masked else None, CAMERA, 0.5)
    packed = PackedView.of(view)
    assert packed.camera is view.camera
    assert packed.image.dtype == np.float32
    np.testing.assert_array_equal(packed.image, view.image)
    assert (packed.mask is None) == (view.mask is None)
    if view.mask is not None:
        np.testing.assert_array_equal(packed.mask, view.mask)
