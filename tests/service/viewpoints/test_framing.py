"""Pictures of another size: what is cropped, and that nothing is stretched or moved."""

import numpy as np
import pytest
from clouds import cloud

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import ViewError
from gapmes.service.splat import render
from gapmes.service.viewpoints.framing import even, frame, parse_size, square, within


def camera(width: int, height: int) -> Camera:
    return Camera.make(width, height, 80.0, 82.0, 0.45 * width, 0.52 * height, np.eye(4))


@pytest.mark.parametrize(("width", "height"), [(95, 63), (95, 64), (96, 63), (96, 64)])
def test_even_sides_cost_the_last_row_and_column_alone(width: int, height: int) -> None:
    """To the bit where all lies in the picture: outside it projections have a bound that the picture's size sets."""
    whole = camera(width, height)
    cut = even(whole)
    assert (cut.width, cut.height) == (width - width % 2, height - height % 2)
    np.testing.assert_array_equal(cut.intrinsics, whole.intrinsics)
    gaussians = cloud(600, 3)
    pixels, _ = cut.project(gaussians.means)
    gaussians = gaussians[((pixels >= 0) & (pixels < (cut.width, cut.height))).all(axis=1)]
    assert len(gaussians) > 150
    expected = render(gaussians, whole, threads=1).rgb[: cut.height, : cut.width]
    np.testing.assert_array_equal(render(gaussians, cut, threads=1).rgb, expected)


def test_a_single_column_stays() -> None:
    thin = Camera.make(1, 63, 1.0, 82.0, 0.5, 31.5, np.eye(4))
    assert (even(thin).width, even(thin).height) == (1, 62)


@pytest.mark.parametrize("given", [(96, 64), (64, 96), (50, 50), (1, 40)])
@pytest.mark.parametrize("wanted", [(96, 64), (48, 32), (30, 90), (200, 10)])
def test_another_shape_is_the_largest_window_about_the_centre(given: tuple[int, int], wanted: tuple[int, int]) -> None:
    """With its rays, lengthened alike across and down; it fills the picture one way at least."""
    whole = Camera.make(*given, 2.0 * given[0], 3.0 * given[1], 0.45 * given[0], 0.52 * given[1], np.eye(4))
    window = frame(whole, *wanted)
    assert (window.width, window.height) == wanted
    assert window.fx / whole.fx == pytest.approx(window.fy / whole.fy)
    corners = np.array([[0.0, 0.0], wanted])
    (left, top), (right, bottom) = whole.project(window.unproject(corners, np.ones(2)))[0]
    assert (left + right, top + bottom) == (pytest.approx(given[0]), pytest.approx(given[1]))
    assert sorted([left, top])[1] > -1e-9
    assert max((right - left) / given[0], (bottom - top) / given[1]) == pytest.approx(1)


def test_of_one_side_the_other_follows_and_of_none_nothing_changes() -> None:
    whole = camera(96, 64)
    assert frame(whole) is whole
    sizes = [
        frame(whole, width=48),
        frame(whole, height=96),
        frame(camera(200, 8), width=5),
        frame(camera(8, 200), None, 5),
    ]
    assert [(one.width, one.height) for one in sizes] == [(48, 32), (144, 96), (5, 1), (1, 5)]


def test_squares_and_the_longest_side() -> None:
    for width, height in ((96, 64), (64, 96)):
        whole = camera(width, height)
        assert (square(whole).width, square(whole).height, square(whole).fx) == (64, 64, whole.fx)
        assert within(whole, 96) is within(whole, 97) is whole
        for side in (72, 48):  # above and below the shorter one
            expected = (width * side // 96, height * side // 96)
            assert (within(whole, side).width, within(whole, side).height) == expected


@pytest.mark.parametrize("text", ["640x480", " 640X480\n", "640×480"])
def test_a_size_is_two_numbers(text: str) -> None:
    assert parse_size(text) == (640, 480)


@pytest.mark.parametrize(
    "text", ["", "640", "640x", "x480", "0x480", "640x0", "-1x5", "640 x 480", "6.4x5", "1x1234567890"]
)
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(ViewError, match="is not a size") as caught:
        parse_size(text)
    assert caught.value.field == "size"
