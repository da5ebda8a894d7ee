"""Depth pictures read back: within half a level of the drawn depth, by the scale in the file."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from gapmes.service.errors import InputError
from gapmes.service.pictures.depth_levels import depth_levels
from gapmes.service.pictures.picture import check_format, encode
from gapmes.service.splat import Render


def drawn(depth: np.ndarray, alpha: np.ndarray | None = None) -> Render:
    alpha = np.ones(depth.shape, np.float32) if alpha is None else alpha
    return Render(np.zeros((*depth.shape, 3), np.float32), alpha, depth.astype(np.float32), {})


def depths(low: float, high: float) -> np.ndarray:
    depth = np.random.default_rng(0).uniform(low, high, (37, 53))
    depth[0, :2] = low, high
    return depth.astype(np.float32)


def read_back(data: bytes) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Levels, depths by the file's own text, and its numbers."""
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode in ("I;16", "I")
        levels = np.asarray(image).astype(np.float64)
        numbers = {name.removeprefix("gapmes:depth_"): float(image.text[name]) for name in image.text if ":" in name}
        assert "level 0: nothing" in image.text["Comment"]
    return levels, numbers["offset"] + numbers["scale"] * levels, numbers


@pytest.mark.parametrize(("low", "high"), [(1.0, 10.0), (0.002, 0.9), (425.0, 905.0), (7.0, 7.0)])
def test_a_png_says_itself_what_its_levels_mean(low: float, high: float) -> None:
    depth = depths(low, high)
    alpha = np.ones(depth.shape, np.float32)
    alpha[5:9] = 0
    picture = encode(drawn(depth, alpha), "depth")
    levels, found, numbers = read_back(picture.data)
    there = alpha > 0
    assert (levels == 0).sum() == (~there).sum()
    assert levels[there].max() == (65535 if high > low else 1)
    assert np.abs(found - depth)[there].max() <= 0.5001 * (high - low) / 65534 + 1e-12
    assert numbers == {name.lower(): value for name, value in picture.depth.named().items()}
    assert numbers["min"] == depth[there].min()
    assert numbers["max"] == depth[there].max()


@pytest.mark.parametrize(("scale", "low", "high"), [(0.001, 1.0, 65.0), (0.001, 0.002, 65.535), (0.25, 425.0, 905.0)])
def test_a_given_scale_is_kept_to_half_a_level(scale: float, low: float, high: float) -> None:
    depth = depths(low, high)
    levels, found, numbers = read_back(encode(drawn(depth), "depth", depth_scale=scale).data)
    assert (numbers["scale"], numbers["offset"]) == (scale, 0.0)
    assert np.abs(found - depth).max() <= 0.5001 * scale
    np.testing.assert_array_equal(levels, np.rint(depth.astype(np.float64) / scale))


def test_a_picture_of_nothing_is_all_level_0() -> None:
    nothing = np.zeros((4, 5), np.float32)
    for scale in (None, 0.001):
        levels, _, numbers = read_back(encode(drawn(nothing, nothing), "depth", depth_scale=scale).data)
        assert not levels.any()
        assert (numbers["min"], numbers["max"]) == (0, 0)


@pytest.mark.parametrize("scale", [None, 0.001])
def test_a_picture_in_which_one_pixel_is_covered_has_one_level(scale: float | None) -> None:
    """Where nothing is there the depth is 0, far from all others; a warning is an error here."""
    there = np.zeros((4, 5), np.float32)
    there[1, 2] = 1
    picture = encode(drawn(np.where(there > 0, np.float32(3), np.float32(0)), there), "depth", depth_scale=scale)
    levels, found, _ = read_back(picture.data)
    assert (levels > 0).sum() == 1
    assert found[1, 2] == pytest.approx(3)


def test_other_channels_have_no_such_text() -> None:
    for channel in ("rgb", "alpha"):
        with Image.open(io.BytesIO(encode(drawn(depths(1, 2)), channel).data)) as image:
            assert image.text == {}


@pytest.mark.parametrize(
    ("scale", "top", "words", "cure"),
    [
        (0.001, 65535, "depth 70 is level 70000 at 0.001 per level, the highest is 65535", "ask for 0.0011 or more"),
        (0.1, 255, "depth 70 is level 700 at 0.1 per level, the highest is 255", "0.28 or more, or for png"),
        (10.0, 65535, "depth 1 is level 0 at 10 per level", "less than 2"),
    ],
)
def test_a_scale_that_does_not_fit_is_refused(scale: float, top: int, words: str, cure: str) -> None:
    depth = depths(1.0, 70.0)
    with pytest.raises(InputError) as caught:
        depth_levels(depth, np.ones(depth.shape, bool), top, scale)
    assert words in caught.value.message
    assert cure in (caught.value.cure or "")
    assert caught.value.field == "depth_scale"
    # and its cure is one
    good = {"0.001": 0.0011, "0.1": 0.28, "10.0": 1.9}[str(scale)]
    depth_levels(depth, np.ones(depth.shape, bool), top, good)


@pytest.mark.parametrize("scale", [2.0, 0.25, 8.0])
def test_a_depth_of_half_a_level_is_refused_as_one_below_is(scale: float) -> None:
    """It is rounded to level 0, which would mean that nothing is there; a little more is level 1."""
    there = np.ones((2, 2), bool)
    for low in (0.5 * scale, np.nextafter(np.float32(0.5 * scale), np.float32(0))):
        with pytest.raises(InputError, match="level 0"):
            depth_levels(np.array([[low, scale], [scale, scale]]), there, 255, scale)
    above = float(np.nextafter(np.float32(0.5 * scale), np.float32(np.inf)))
    levels, _ = depth_levels(np.array([[above, scale], [scale, scale]]), there, 255, scale)
    assert levels.min() == 1


@pytest.mark.parametrize("low", [1.0, 1.049, 0.0996, 7.77])
def test_every_scale_below_the_one_of_the_cure_is_taken(low: float) -> None:
    depth, there = np.array([[low, 9.0]]), np.ones((1, 2), bool)
    with pytest.raises(InputError) as caught:
        depth_levels(depth, there, 255, 100.0)
    least = float((caught.value.cure or "").removeprefix("ask for less than "))
    assert depth_levels(depth, there, 255, np.nextafter(least, 0))[0].min() == 1


@pytest.mark.parametrize(("channel", "scale", "words"), [("rgb", 0.1, "not with rgb"), ("depth", 0.0, "is 0"),
                                                          ("depth", float("nan"), "is nan"),
                                                          ("depth", float("inf"), "is inf")])  # fmt: skip
def test_a_scale_that_is_none_is_refused_before_drawing(channel, scale, words) -> None:
    check_format(10, 10, "depth", "png", 1e-9)
    with pytest.raises(InputError, match=words):
        check_format(10, 10, channel, "png", scale)
