"""Photographs: bounds before decoding, every mode of the three formats, and crops whose intrinsics follow exactly."""

import contextlib
import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import ImageError, ImageTooLarge, ImageUnreadable
from gapmes.service.photographs.images import FittedView, PackedView, Photo, decode_image, fit_view, match_photo


def encoded(image: Image.Image, kind: str = "PNG", **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def picture(width=40, height=36, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def png(width: int, height: int, bits: int, colour_type: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG of these chunks behind its header."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, bits, colour_type, 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def png_header(width: int, height: int) -> bytes:
    """A PNG that claims a size and holds no pixels: whoever decodes it before looking at the size fails otherwise."""
    return png(width, height, 8, 2, (b"IDAT", b""))


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_lossless_formats_are_decoded_to_the_bit(kind):
    photo = decode_image(encoded(Image.fromarray(picture()), kind, lossless=True), index=0)
    np.testing.assert_array_equal(photo.rgb, picture())
    assert photo.mask is None
    assert (photo.width, photo.height, photo.orientation) == (40, 36, 1)


def test_text_named_as_an_image_is_415():
    with pytest.raises(ImageUnreadable, match="are not a JPEG, PNG, WEBP file") as caught:
        decode_image(b"this is not a picture", index=3)
    assert (caught.value.status, caught.value.index) == (415, 3)


@pytest.mark.parametrize("kind", ["GIF", "BMP", "TIFF"])
def test_other_formats_are_415(kind):
    with pytest.raises(ImageUnreadable):
        decode_image(encoded(Image.fromarray(picture()), kind), index=0)


@pytest.mark.filterwarnings("error::PIL.Image.DecompressionBombWarning")  # ours is the only word on it
@pytest.mark.parametrize(("width", "height"), [(10_000, 10_000), (30_000, 30_000), (64_000_001, 32)])
def test_bombs_are_413_before_decoding(width, height):
    """The file has no pixel data, so that only the header can have been read."""
    with pytest.raises(ImageTooLarge, match="64000000") as caught:
        decode_image(png_header(width, height), index=1)
    assert (caught.value.status, caught.value.index) == (413, 1)


def test_the_pixel_limit_is_an_option():
    data = encoded(Image.fromarray(picture(100, 100)))
    assert decode_image(data, index=0, max_pixels=10_000).width == 100
    with pytest.raises(ImageTooLarge, match="100 x 100 = 10000 pixels, the limit is 9999"):
        decode_image(data, index=0, max_pixels=9_999)


@pytest.mark.case("P9")
@pytest.mark.parametrize(("width", "height"), [(1, 1), (31, 64), (64, 31)])
def test_tiny_images_are_refused_with_the_minimum(width, height):
    with pytest.raises(ImageError, match=f"is {width} x {height} px, need at least 32 x 32") as caught:
        decode_image(encoded(Image.fromarray(picture(width, height))), index=0)
    assert caught.value.status == 422


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_truncated_files_are_415(kind):
    data = encoded(Image.fromarray(picture(200, 200)), kind)
    for length in (0, 1, 10, 30, len(data) // 2):
        with pytest.raises(ImageUnreadable):
            decode_image(data[:length], index=0)


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["PNG", "JPEG", "WEBP"]), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=6)
)
def test_damaged_files_decode_or_are_refused(kind, changes):
    data = bytearray(encoded(Image.fromarray(picture(48, 48)), kind))
    for position, value in changes:
        data[position % len(data)] = value
    with contextlib.suppress(ImageError):  # any other exception fails the test
        assert decode_image(bytes(data), index=0, max_pixels=1_000_000).rgb.dtype == np.uint8


def test_animations_are_refused():
    frames = [Image.fromarray(picture(seed=i)) for i in range(3)]
    data = encoded(frames[0], "PNG", save_all=True, append_images=frames[1:])
    with pytest.raises(ImageError, match="animation of 3 frames"):
        decode_image(data, index=0)


def test_greyscale_palette_and_one_bit():
    grey = picture()[:, :, 0]
    photo = decode_image(encoded(Image.fromarray(grey)), index=0)
    np.testing.assert_array_equal(photo.rgb, np.repeat(grey[:, :, None], 3, axis=2))
    palette = Image.fromarray(picture()).quantize(16)
    photo = decode_image(encoded(palette), index=0)
    np.testing.assert_array_equal(photo.rgb, np.asarray(palette.convert("RGB")))
    bits = Image.fromarray(grey > 127)
    np.testing.assert_array_equal(decode_image(encoded(bits), index=0).rgb[:, :, 0], (grey > 127) * 255)


def test_sixteen_bit_greyscale_keeps_its_range():
    """Clipping at 255, the usual accident, would turn all of it white."""
    levels = np.linspace(0, 65535, 40 * 36).reshape(36, 40).astype(np.uint16)
    photo = decode_image(encoded(Image.fromarray(levels)), index=0)
    np.testing.assert_array_equal(photo.rgb[:, :, 1], np.rint(levels / 257.0).astype(np.uint8))


def of_one_row(bits: int, colour_type: int, row: bytes, transparent: tuple[int, ...]) -> bytes:
    """A PNG of 40 x 36 px, all rows alike, with a transparent level or colour."""
    pixels = zlib.compress((b"\0" + row) * 36)
    return png(
        40, 36, bits, colour_type, (b"tRNS", struct.pack(f">{len(transparent)}H", *transparent)), (b"IDAT", pixels)
    )


def test_colours_of_sixteen_bits_keep_their_upper_eight():
    """A level off at most from the rounded ones; grey with an alpha channel likewise."""
    values = np.linspace(0, 65535, 40 * 3).astype(">u2")
    rgb = decode_image(png(40, 36, 16, 2, (b"IDAT", zlib.compress((b"\0" + values.tobytes()) * 36))), index=0).rgb
    np.testing.assert_array_equal(rgb, np.tile((values >> 8).reshape(40, 3), (36, 1, 1)))
    assert np.abs(rgb.reshape(36, -1) - np.rint(values / 257.0)).max() == 1
    both = np.column_stack([values[:40], np.full(40, 65535, ">u2")]).astype(">u2")
    grey = decode_image(png(40, 36, 16, 4, (b"IDAT", zlib.compress((b"\0" + both.tobytes()) * 36))), index=0)
    np.testing.assert_array_equal(grey.rgb, np.tile((values[:40] >> 8)[:, None], (36, 1, 3)))


def test_a_transparent_level_of_sixteen_bits_is_a_mask():
    """The level as it is in the file: its neighbours become the same 8 bits, and stay."""
    levels = np.repeat(np.array([999, 1000, 1001, 50000]), 10)
    photo = decode_image(of_one_row(16, 0, levels.astype(">u2").tobytes(), (1000,)), index=0)
    np.testing.assert_array_equal(photo.mask, np.tile(levels != 1000, (36, 1)))
    np.testing.assert_array_equal(photo.rgb[:, :, 2], np.tile(np.rint(levels / 257.0), (36, 1)))
    assert decode_image(of_one_row(16, 0, levels.astype(">u2").tobytes(), (1002,)), index=0).mask is None


@pytest.mark.parametrize(("bits", "level"), [(1, 1), (2, 1), (4, 3), (8, 7)])
def test_a_transparent_level_of_few_bits_is_a_mask(bits, level):
    levels = np.repeat([0, level], 20).astype(np.uint8)
    row = np.packbits(np.unpackbits(levels[:, None], axis=1)[:, -bits:].ravel()).tobytes()
    photo = decode_image(of_one_row(bits, 0, row, (level,)), index=0)
    np.testing.assert_array_equal(photo.mask, np.tile(levels == 0, (36, 1)))


@pytest.mark.parametrize(("bits", "colour"), [(8, (1, 2, 3)), (16, (1000, 2000, 3000))])
def test_a_transparent_colour_is_a_mask(bits, colour):
    row = np.repeat(np.array([colour, [4 << bits - 8] * 3]), 20, axis=0).astype(">u2" if bits == 16 else np.uint8)
    photo = decode_image(of_one_row(bits, 2, row.tobytes(), colour), index=0)
    np.testing.assert_array_equal(photo.mask, np.tile(np.arange(40) >= 20, (36, 1)))


def test_cmyk_jpeg_is_converted():
    colour = Image.new("CMYK", (40, 40), (0, 255, 255, 0))  # no cyan, full magenta and yellow: red
    rgb = decode_image(encoded(colour, "JPEG", quality=95), index=0).rgb
    np.testing.assert_allclose(rgb.reshape(-1, 3).mean(axis=0), [255, 0, 0], atol=4)


def test_alpha_becomes_the_mask():
    alpha = np.zeros((36, 40), np.uint8)
    alpha[:, 10:] = 127
    alpha[:, 20:] = 128
    photo = decode_image(encoded(Image.fromarray(np.dstack([picture(), alpha]))), index=0)
    np.testing.assert_array_equal(photo.mask, alpha >= 128)
    np.testing.assert_array_equal(photo.rgb, picture())
    opaque = np.dstack([picture(), np.full((36, 40), 255, np.uint8)])
    assert decode_image(encoded(Image.fromarray(opaque)), index=0).mask is None
    transparent = np.dstack([picture(), np.zeros((36, 40), np.uint8)])
    with pytest.raises(ImageError, match="the mask leaves no pixel"):
        decode_image(encoded(Image.fromarray(transparent)), index=0)


def test_a_transparent_palette_colour_is_a_mask():
    indices = np.zeros((40, 40), np.uint8)
    indices[:, 20:] = 1
    image = Image.fromarray(indices, "L")
    palette = Image.new("P", image.size)
    palette.putdata(list(indices.ravel()))
    palette.putpalette([10, 20, 30, 200, 210, 220])
    photo = decode_image(encoded(palette, transparency=0), index=0)
    np.testing.assert_array_equal(photo.mask, indices == 1)
    assert photo.rgb[0, 30].tolist() == [200, 210, 220]


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
    upright, turned_camera = match_photo(photo, camera(72, 128))
    np.testing.assert_array_equal(upright.rgb, np.asarray(ImageOps.exif_transpose(Image.open(io.BytesIO(data)))))
    assert (turned_camera.width, turned_camera.height) == (36, 64)


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
