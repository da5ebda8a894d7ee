"""Photographs given in Python: PIL images as displayed, bytes of any kind, and cures for all else."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from encoded_pictures import encoded, picture
from PIL import Image

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import ImageError, ImageUnreadable
from gapmes.service.network.engine import Engine
from gapmes.service.photographs.arrays import checked_pixels
from gapmes.service.photographs.fitting import Picture, fitted
from gapmes.service.photographs.images import Photo, decode_image

SIZE = (96, 72)
CAMERA = Camera.make(*SIZE, 90.0, 90.0, 48.0, 36.0, np.eye(4))


def view(image: Picture, engine: Engine) -> np.ndarray:
    return fitted(image, CAMERA, 1, engine.info.shape)[0].image


def refusal(image: object, engine: Engine) -> ImageError:
    with pytest.raises(ImageError) as caught:
        view(image, engine)
    assert (caught.value.field, caught.value.index) == ("images", 1)
    return caught.value


@pytest.mark.parametrize(
    ("mode", "kind"),
    [
        ("RGB", "PNG"),
        ("RGB", "JPEG"),
        ("CMYK", "JPEG"),
        ("L", "PNG"),
        ("1", "PNG"),
        ("P", "PNG"),
        ("LA", "PNG"),
        ("RGBA", "WEBP"),
    ],
)
def test_an_opened_image_is_that_of_its_file(mode: str, kind: str) -> None:
    made = Image.fromarray(picture(*SIZE)).convert(mode)
    if mode[-1] == "A":
        made.putalpha(Image.fromarray(picture(*SIZE, seed=1)[:, :, 0]))
    data = encoded(made, kind, lossless=True) if kind == "WEBP" else encoded(made, kind)
    expected, found = decode_image(data, index=0), Photo.from_array(Image.open(io.BytesIO(data)))
    np.testing.assert_array_equal(found.rgb, expected.rgb)
    np.testing.assert_array_equal(found.mask, expected.mask)
    assert (found.mask is None) == (mode[-1] != "A")


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("mode", ["I;16", "P"])
def test_a_transparent_level_of_sixteen_bits_or_entry_of_a_palette_needs_no_file(mode: str, transparent: bool) -> None:
    deep = Image.fromarray(np.arange(96 * 72, dtype=np.uint16).reshape(72, 96))
    made = deep if mode == "I;16" else Image.fromarray(picture(*SIZE)).convert(mode)
    data = encoded(made, "PNG", **({"transparency": made.getpixel((9, 5))} if transparent else {}))
    expected, found = decode_image(data, index=0), Photo.from_array(Image.open(io.BytesIO(data)))
    np.testing.assert_array_equal(found.rgb, expected.rgb)
    np.testing.assert_array_equal(found.mask, expected.mask)
    assert (found.mask is not None) == transparent


def test_luma_and_chroma_are_not_taken_for_colours(engine: Engine) -> None:
    image = Image.fromarray(picture(*SIZE))
    plain = view(np.asarray(image), engine)
    for mode, most in (("YCbCr", 0.02), ("HSV", 0.02), ("CMYK", 0.0), ("RGBX", 0.0)):
        assert np.abs(view(image.convert(mode), engine) - plain).max() <= most


def test_what_exif_says_is_known_of_an_opened_image() -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    data = encoded(Image.fromarray(picture(*SIZE)), "JPEG", exif=exif)
    assert Photo.from_array(Image.open(io.BytesIO(data))).orientation == 6
    assert Photo.from_array(Image.fromarray(picture(*SIZE))).orientation == 1


@pytest.mark.parametrize("mode", ["F", "I", "LAB", "La"])
def test_modes_without_eight_bit_colours_are_refused_by_name(mode: str, engine: Engine) -> None:
    error = refusal(Image.new(mode, SIZE), engine)
    assert error.message == f"is a PIL image of mode {mode}, need one that becomes 8-bit RGB"
    assert "8-bit RGB" in error.cure


@pytest.mark.parametrize(("mode", "transparent"), [("L", 5), ("RGB", (1, 2, 3))])
def test_a_transparent_level_of_unknown_depth_is_refused(mode: str, transparent: object, engine: Engine) -> None:
    """A file says how many bits it has, Pillow does not; the same file as bytes is taken."""
    data = encoded(Image.fromarray(picture(*SIZE)).convert(mode), "PNG", transparency=transparent)
    error = refusal(Image.open(io.BytesIO(data)), engine)
    assert f"of mode {mode} with a transparent level or colour" in error.message
    assert "path or the bytes of its file" in error.cure
    assert view(data, engine).shape[0] == 3


def test_a_damaged_opened_image_is_refused(engine: Engine) -> None:
    data = encoded(Image.fromarray(picture(*SIZE)), "JPEG")
    error = refusal(Image.open(io.BytesIO(data[: len(data) // 2])), engine)
    assert isinstance(error, ImageUnreadable)


def test_bytes_of_any_kind_are_those_of_a_file(engine: Engine) -> None:
    data = encoded(Image.fromarray(picture(*SIZE)), "PNG")
    for given in (bytearray(data), memoryview(data), memoryview(bytearray(data))):
        np.testing.assert_array_equal(view(given, engine), view(data, engine))
    np.testing.assert_array_equal(view(memoryview(picture(*SIZE)), engine), view(picture(*SIZE), engine))


def test_files_and_other_things_are_refused_with_a_cure(engine: Engine, tmp_path: Path) -> None:
    data = encoded(Image.fromarray(picture(*SIZE)), "PNG")
    (tmp_path / "a.png").write_bytes(data)
    with (tmp_path / "a.png").open("rb") as file:
        for given, name in ((io.BytesIO(data), "BytesIO"), (file, "BufferedReader")):
            error = refusal(given, engine)
            assert error.message == f"is a {name}, need uint8 (H, W, 3) or (H, W, 4)"
            assert "read() returns" in error.cure
    error = refusal(None, engine)
    assert error.message.startswith("is a NoneType")
    assert "give a path" in error.cure
    error = refusal(np.frombuffer(data, np.uint8), engine)
    assert "tobytes()" in error.cure


@pytest.mark.parametrize(
    ("wrong", "cure", "mended"),
    [
        (lambda rgb: rgb[:, :, 0], "np.stack([array] * 3, axis=-1)", lambda array: np.stack([array] * 3, axis=-1)),
        (lambda rgb: rgb[:, :, :1], "np.repeat(array, 3, axis=-1)", lambda array: np.repeat(array, 3, axis=-1)),
        (lambda rgb: rgb.transpose(2, 0, 1), "array.transpose(1, 2, 0)", lambda array: array.transpose(1, 2, 0)),
        (
            lambda rgb: rgb / np.float32(255),
            "np.rint(255 * array).astype(np.uint8)",
            lambda array: np.rint(255 * array).astype(np.uint8),
        ),
        (
            lambda rgb: rgb * np.uint16(257),
            "np.rint(array / 257).astype(np.uint8)",
            lambda array: np.rint(array / 257).astype(np.uint8),
        ),
    ],
    ids=["grey", "grey with a channel", "channels first", "0 to 1", "16 bits"],
)
def test_arrays_of_other_shapes_are_refused_with_what_mends_them(wrong, cure, mended, engine: Engine) -> None:
    array = wrong(picture(*SIZE))
    assert cure in refusal(array, engine).cure
    assert view(mended(array), engine).shape[0] == 3
    assert "255" not in refusal(array.astype(np.int64), engine).cure


@pytest.mark.parametrize(
    ("name", "said", "cure"),
    [
        ("none.png", "No such file or directory", "a relative path counts from the working folder"),
        (".", "Is a directory", "give the photographs in it"),
        ("\0", "embedded null byte", "is it spelled so"),
    ],
)
def test_a_path_without_a_photograph_is_refused_with_a_cure(
    name: str, said: str, cure: str, engine: Engine, tmp_path: Path
) -> None:
    error = refusal(tmp_path / name, engine)
    assert error.message.endswith(f"cannot be read: {said}")
    assert cure in error.cure


@pytest.mark.parametrize("shape", [(3, 8, 9), (4, 8, 9)])
def test_channels_first_are_told_with_and_without_opacity(shape: tuple[int, ...]) -> None:
    with pytest.raises(ImageError) as caught:
        checked_pixels(np.zeros(shape, np.uint8), 2)
    assert caught.value.cure == "put the channels last: array.transpose(1, 2, 0)"
    assert f"array is uint8 of shape {shape}" in caught.value.message


@pytest.mark.parametrize(("kind", "told"), [(np.uint16, True), (np.uint32, False), (np.uint64, False)])
def test_only_of_sixteen_bits_the_cure_is_for_sixteen_bits(kind: type, told: bool) -> None:
    """Of 32 bits most arrays hold levels up to 255, which a division would make black."""
    with pytest.raises(ImageError) as caught:
        checked_pixels(np.full((8, 9, 3), 200, kind), 2)
    assert ("257" in caught.value.cure) == told
