"""Photographs in the colours of another profile become sRGB; a profile that cannot be used is told."""

from __future__ import annotations

import io
import tracemalloc

import numpy as np
import pytest
from icc_profiles import ADOBE_RGB, DISPLAY_P3, SRGB, Space, cmyk_profile, converted, grey_profile
from numpy.typing import NDArray
from PIL import Image, ImageCms

from gapmes.service.cameras.camera import Camera
from gapmes.service.photographs.fitting import fitted
from gapmes.service.photographs.images import Photo, decode_image

LEVELS = 1.0  # measured up to 0.8 of 255: half of it is rounding
PIXELS = np.random.default_rng(5).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def encoded(image: Image.Image, profile: bytes | None, kind: str = "PNG") -> bytes:
    data = io.BytesIO()
    options = {"lossless": True} if kind == "WEBP" else {}
    image.save(data, kind, icc_profile=profile, **options)
    return data.getvalue()


def rgb(image: Image.Image, profile: bytes | None, kind: str = "PNG") -> NDArray[np.uint8]:
    return decode_image(encoded(image, profile, kind), index=0).rgb


@pytest.mark.parametrize("space", [DISPLAY_P3, ADOBE_RGB])
@pytest.mark.parametrize("kind", ["PNG", "WEBP", "JPEG"])
def test_colours_are_those_of_the_profile(space: Space, kind: str) -> None:
    image = Image.fromarray(PIXELS)
    as_stored = rgb(image, None, kind)
    found = rgb(image, space.profile(), kind)
    assert np.abs(found - converted(as_stored, space, SRGB)).max() < LEVELS
    assert np.abs(found.astype(int) - as_stored).max() > 20


@pytest.mark.parametrize(
    "profile", [SRGB.profile(), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()]
)
def test_those_of_srgb_stay_to_the_bit(profile: bytes) -> None:
    np.testing.assert_array_equal(rgb(Image.fromarray(PIXELS), profile), PIXELS)


@pytest.mark.parametrize(("red", "stays"), [(0.6395, True), (0.6391, False)])
def test_one_that_changes_no_colour_by_more_than_a_level_is_that_of_srgb(red: float, stays: bool) -> None:
    """Another red, which changes some of these colours by a level, and corners of the cube by up to 1.1 and 1.9."""
    space = Space(((red, 0.33), *SRGB.primaries[1:]))
    assert (np.rint(converted(PIXELS, space, SRGB)) != PIXELS).any()
    assert (rgb(Image.fromarray(PIXELS), space.profile()) == PIXELS).all() == stays


def test_alpha_stays_and_so_does_a_transparent_colour() -> None:
    alpha = np.where(PIXELS[..., 0] > 100, 255, 0).astype(np.uint8)
    photo = decode_image(encoded(Image.fromarray(np.dstack([PIXELS, alpha])), DISPLAY_P3.profile()), index=0)
    np.testing.assert_array_equal(photo.mask, alpha > 0)
    assert np.abs(photo.rgb - converted(PIXELS, DISPLAY_P3, SRGB)).max() < LEVELS
    palette = Image.fromarray(PIXELS).quantize(16)
    data = io.BytesIO()
    palette.save(data, "PNG", transparency=3, icc_profile=DISPLAY_P3.profile())
    photo = decode_image(data.getvalue(), index=0)
    np.testing.assert_array_equal(photo.mask, np.asarray(palette) != 3)
    expected = converted(np.asarray(palette.convert("RGB")), DISPLAY_P3, SRGB)
    assert np.abs(photo.rgb - expected).max() < LEVELS


def test_inks_are_those_of_their_profile() -> None:
    """K of 50 % leaves L* = 50, which is a level of 119 of sRGB; without a profile it is half of 255."""
    image = Image.new("CMYK", (64, 48), (0, 0, 0, 128))
    assert abs(int(Photo.from_image(image).rgb[0, 0, 0]) - 127) <= 1
    image.info["icc_profile"] = cmyk_profile()
    assert np.abs(Photo.from_image(image).rgb.astype(int) - 118).max() <= 2
    plain = Image.new("CMYK", (64, 48))
    assert rgb(plain, cmyk_profile(), "JPEG").min() >= 254


def test_levels_of_grey_are_taken_as_those_of_srgb() -> None:
    grey = Image.fromarray(PIXELS[..., 0])
    photo = decode_image(encoded(grey, grey_profile()), index=0)
    np.testing.assert_array_equal(photo.rgb, np.repeat(PIXELS[..., :1], 3, axis=2))
    assert photo.profile_problem is None


GREYS = [
    Image.fromarray(PIXELS[..., 0]),
    Image.merge("LA", [Image.fromarray(PIXELS[..., 0]), Image.new("L", (64, 48), 255)]),
    Image.fromarray(PIXELS[..., 0].astype(np.uint16) * 257),
]


@pytest.mark.parametrize("grey", GREYS, ids=["8 bits", "with alpha", "16 bits"])
@pytest.mark.parametrize(
    ("profile", "why"),
    [
        (grey_profile(), None),
        (SRGB.profile(), None),  # many a tool leaves it there
        (ADOBE_RGB.profile(), "it is one of RGB, the photograph has grey levels"),
        (cmyk_profile(), "it is one of CMYK, the photograph has grey levels"),
        (b"no profile", "it cannot be read: "),
    ],
    ids=["grey", "sRGB", "Adobe RGB", "CMYK", "damaged"],
)
def test_levels_of_grey_stay_whatever_the_profile(grey: Image.Image, profile: bytes, why: str | None) -> None:
    """In 8 bits and 16 alike, and one that is not of grey levels is told."""
    photo = decode_image(encoded(grey, profile), index=0)
    np.testing.assert_array_equal(photo.rgb, np.repeat(PIXELS[..., :1], 3, axis=2))
    assert (photo.profile_problem is None) == (why is None)
    assert (photo.profile_problem or "").startswith(why or "")


@pytest.mark.parametrize(("mode", "kind", "has"), [("RGB", "PNG", "RGB"), ("CMYK", "JPEG", "CMYK")])
def test_colours_with_a_profile_of_grey_levels_are_told(mode: str, kind: str, has: str) -> None:
    photo = decode_image(encoded(Image.fromarray(PIXELS).convert(mode), grey_profile(), kind), index=0)
    assert photo.profile_problem == f"it is one of grey levels, the photograph has {has}"


def test_the_callers_image_is_left_alone() -> None:
    image = Image.fromarray(PIXELS)
    image.info["icc_profile"] = DISPLAY_P3.profile()
    photo = Photo.from_image(image)
    np.testing.assert_array_equal(np.asarray(image), PIXELS)
    assert np.abs(photo.rgb - converted(PIXELS, DISPLAY_P3, SRGB)).max() < LEVELS


@pytest.mark.parametrize(
    ("profile", "why"),
    [(b"no profile", "it cannot be read: "), (cmyk_profile(), "it is one of CMYK, the photograph has RGB")],
)
def test_one_that_cannot_be_used_is_told(profile: bytes, why: str) -> None:
    data = encoded(Image.fromarray(PIXELS), profile)
    view, _, notices = fitted(data, Camera.make(64, 48, 60, 60, 32, 24, np.eye(4)), 3, (48, 64))
    (notice,) = notices
    assert (notice["code"], notice["field"], notice["index"]) == ("colour_profile_ignored", "images", 3)
    assert f"its colour profile is not used, {why}" in notice["message"]
    np.testing.assert_array_equal(np.rint(view.image.transpose(1, 2, 0) * 255), PIXELS)


def test_damaged_ones_are_refused_or_used_but_break_nothing() -> None:
    """Cut anywhere, or with a byte changed anywhere."""
    profile = DISPLAY_P3.profile()
    image, generator = Image.fromarray(PIXELS), np.random.default_rng(3)
    for _ in range(60):
        changed = bytearray(profile)
        changed[generator.integers(0, 700)] = generator.integers(0, 256)
        for damaged in (bytes(changed), profile[: generator.integers(1, len(profile))]):
            image.info["icc_profile"] = damaged
            photo = Photo.from_image(image)
            if photo.profile_problem is not None:
                np.testing.assert_array_equal(photo.rgb, PIXELS)


def test_large_ones_are_used_and_not_kept_in_memory() -> None:
    """Profiles come from strangers, and nothing but the body's limit bounds them."""
    image, size = Image.fromarray(PIXELS), 4 * 2**20
    tracemalloc.start()
    try:
        for last in range(3):
            image.info["icc_profile"] = b"".join((DISPLAY_P3.profile(), bytes(size), bytes([last])))
            found = Photo.from_image(image).rgb
        image.info.clear()
        assert tracemalloc.get_traced_memory()[0] < size  # 12 MB with all three
    finally:
        tracemalloc.stop()
    assert np.abs(found - converted(PIXELS, DISPLAY_P3, SRGB)).max() < LEVELS


def test_a_scene_sees_the_same_colours_in_either_profile() -> None:
    """A photograph that a phone saves in Display P3 and one that it saves in sRGB."""
    generator = np.random.default_rng(8)
    in_p3 = generator.integers(60, 200, (48, 64, 3)).astype(np.uint8)
    as_srgb = np.rint(converted(in_p3, DISPLAY_P3, SRGB)).astype(np.uint8)
    camera = Camera.make(64, 48, 60, 60, 32, 24, np.eye(4))
    one, other = (
        fitted(encoded(Image.fromarray(pixels), profile), camera, 0, (32, 48))[0].image
        for pixels, profile in ((in_p3, DISPLAY_P3.profile()), (as_srgb, SRGB.profile()))
    )
    assert np.abs(one - other).max() < 2 * LEVELS / 255
