"""Pictures of each channel decoded again, what cannot be encoded, and colours of backgrounds."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_depth_levels import depths, drawn

from gapmes.service.errors import InputError, ViewError
from gapmes.service.pictures.depth_levels import depth_levels
from gapmes.service.pictures.picture import MAX_SIDE, check_format, encode, parse_background


def levels_of(data: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(data)) as image:
        found = np.asarray(image).astype(int)
    return found if found.ndim == 2 else found[:, :, 0]


@pytest.mark.parametrize("format", ["png", "webp"])
def test_opacity_is_held_to_the_nearest_of_255_levels(format: Any) -> None:
    """What is beyond 1 counts as 1."""
    alpha = np.array([[0.0, 0.3 / 255, 0.6 / 255, 0.5], [254.4 / 255, 254.6 / 255, 1.0, 1.01]], np.float32)
    picture = encode(drawn(np.ones((2, 4)), alpha), "alpha", format)
    assert (picture.media_type, picture.depth) == (f"image/{format}", None)
    assert levels_of(picture.data).tolist() == [[0, 0, 1, 128], [254, 255, 255, 255]]


def test_depth_in_webp_has_255_levels_to_half_a_level() -> None:
    depth = depths(2.0, 5.0)
    picture = encode(drawn(depth), "depth", "webp")
    levels = levels_of(picture.data)
    assert (levels.min(), levels.max()) == (1, 255)
    assert picture.depth is not None
    assert np.abs(picture.depth.offset + picture.depth.scale * levels - depth).max() <= 0.5001 * 3 / 254


@pytest.mark.parametrize(("scale", "told"), [(None, 0.0), (0.25, 0.25)])
def test_of_a_picture_of_nothing_all_numbers_are_0_but_a_scale_that_was_given(scale: float | None, told: float) -> None:
    nothing = np.zeros((4, 5), bool)
    assert depth_levels(np.ones((4, 5)), nothing, 255, scale)[1].named() == {
        "Min": 0.0,
        "Max": 0.0,
        "Scale": told,
        "Offset": 0.0,
    }


def test_the_highest_level_holds_half_a_level_more() -> None:
    there = np.ones((1, 2), bool)
    levels, code = depth_levels(np.array([[1.0, 255.49]]), there, 255, 1.0)
    assert (levels.tolist(), levels.dtype) == ([[1, 255]], np.uint8)
    assert code.named() == {"Min": 1.0, "Max": 255.49, "Scale": 1.0, "Offset": 0.0}
    with pytest.raises(InputError, match="is level 256 at 1 per level, the highest is 255"):
        depth_levels(np.array([[1.0, 255.51]]), there, 255, 1.0)


@pytest.mark.parametrize("channel", ["alpha", "depth"])
def test_levels_that_mean_something_are_not_put_into_jpeg(channel: Any) -> None:
    check_format(8, 8, "rgb", "jpeg")
    with pytest.raises(InputError, match=f"{channel} in JPEG would lose its levels") as caught:
        check_format(8, 8, channel, "jpeg")
    assert caught.value.field == "format"


@pytest.mark.parametrize("format", MAX_SIDE)
def test_a_side_may_be_as_long_as_its_format_holds(format: Any) -> None:
    most = MAX_SIDE[format]
    check_format(most, most, "rgb", format)
    for size, field in (((most + 1, 8), "width"), ((8, most + 1), "height")):
        with pytest.raises(InputError, match=f"{field} is {most + 1} px, the limit of {format} is {most}") as caught:
            check_format(*size, "rgb", format)
        assert caught.value.field == field


@pytest.mark.parametrize(
    ("text", "colour"),
    [
        ("#ff8000", (255, 128, 0)),
        (" 0A0b0C ", (10, 11, 12)),
        ("black", (0, 0, 0)),
        ("White", (255, 255, 255)),
        ("grey", (127.5, 127.5, 127.5)),
    ],
)
def test_a_background_is_a_colour(text: str, colour: tuple[float, ...]) -> None:
    assert parse_background(text) == pytest.approx([level / 255 for level in colour])


@pytest.mark.parametrize("text", ["", "#fff", "#ff80001", "##ff8000", "gray-ish", "#gg8000", "255,0,0"])
def test_what_is_no_colour_is_refused(text: str) -> None:
    with pytest.raises(ViewError, match="is not a colour") as caught:
        parse_background(text)
    assert caught.value.field == "background"
    assert "one of black, white, grey" in str(caught.value.cure)


@pytest.mark.parametrize("top", [255, 65535])
def test_half_a_level_above_the_highest_is_the_highest(top: int) -> None:
    """To even it would be rounded to one more, which an integer of its bits holds as 0: nothing there."""
    levels, _ = depth_levels(np.array([[1.0, top + 0.5]]), np.ones((1, 2), bool), top, 1.0)
    assert levels.tolist() == [[1, top]]


def test_a_jpeg_has_all_of_its_colours() -> None:
    """Columns of red and blue by turns, which half the resolution of colour would mix."""
    render = drawn(np.ones((32, 32)))
    render.rgb[:, ::2, 0] = render.rgb[:, 1::2, 2] = 1.0
    with Image.open(io.BytesIO(encode(render, "rgb", "jpeg").data)) as image:
        found = np.asarray(image).astype(int)
    assert (found[:, ::2, 0] - found[:, ::2, 2]).min() > 150
    assert (found[:, 1::2, 2] - found[:, 1::2, 0]).min() > 150
