"""Photographs: bounds before decoding, and every mode of the three formats."""

from __future__ import annotations

import contextlib
import struct
import zlib

import numpy as np
import pytest
from encoded_pictures import encoded, picture
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from gapmes.service.errors import ImageError, ImageTooLarge, ImageUnreadable
from gapmes.service.photographs.images import decode_image


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
    with pytest.raises(ImageUnreadable, match=r"are not a JPEG, PNG, WEBP file \(save") as caught:
        decode_image(b"this is not a picture", index=3)
    assert (caught.value.status, caught.value.index) == (415, 3)


@pytest.mark.parametrize("kind", ["GIF", "BMP", "TIFF"])
def test_other_formats_are_415(kind):
    with pytest.raises(ImageUnreadable):
        decode_image(encoded(Image.fromarray(picture()), kind), index=0)


@pytest.mark.parametrize(
    ("start", "name"),
    [
        (b"\0\0\0\x24ftypheic", "HEIC"),
        (b"\0\0\0\x0aftypmif1", "HEIC"),
        (b"\0\0\0\x20ftypavif", "AVIF"),
        (b"II*\0", "TIFF or raw"),
        (b"MM\0*", "TIFF or raw"),
    ],
)
def test_formats_of_phones_and_cameras_are_named(start, name):
    with pytest.raises(ImageUnreadable, match=rf"not a JPEG, PNG, WEBP file, but {name} \(save"):
        decode_image(start + bytes(40), index=0)


@pytest.mark.filterwarnings("error::PIL.Image.DecompressionBombWarning")  # ours is the only word on it
@pytest.mark.parametrize(("width", "height"), [(10_000, 10_000), (30_000, 30_000), (64_000_001, 32)])
def test_bombs_are_413_before_decoding(width, height):
    """The file has no pixel data, so that only the header can have been read."""
    with pytest.raises(ImageTooLarge, match="64000000") as caught:
        decode_image(png_header(width, height), index=1)
    assert (caught.value.status, caught.value.index) == (413, 1)


def test_a_limit_above_pillows_own_is_not_named_as_the_reason():
    own = 2 * Image.MAX_IMAGE_PIXELS
    with pytest.raises(ImageTooLarge, match=f"has more pixels than the limit of {own}"):
        decode_image(png_header(20_000, 10_000), index=0, max_pixels=400_000_000)


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


@settings(max_examples=150)
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
