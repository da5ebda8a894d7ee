"""The pinhole camera by its equations, and the ends of what its numbers may be."""

import numpy as np
import pytest

from gapmes.service.cameras.camera import MAX_SIDE, Camera, pixel_grid
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.errors import CameraError, IntrinsicsError

POSE = np.eye(4)
POSE[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), np.pi / 2)  # looks along x; its right is -z
POSE[:3, 3] = 5.0, 6.0, 7.0
CAMERA = Camera.make(64, 48, 50.0, 40.0, 30.0, 20.0, POSE)


def test_a_pixel_at_a_depth_is_one_point_and_back() -> None:
    """(30 + 50, 20 - 80) px lies 1 to the right and 2 up of 1 ahead."""
    point = CAMERA.unproject(np.array([[80.0, -60.0]]), np.array([3.0]))
    np.testing.assert_allclose(point, [[5 + 3, 6 - 6, 7 - 3]], atol=1e-14)
    pixel, depth = CAMERA.project(point)
    np.testing.assert_allclose(pixel, [[80.0, -60.0]], atol=1e-12)
    np.testing.assert_allclose(depth, [3.0], atol=1e-14)
    behind, depth = CAMERA.project(np.array([[4.0, 6.0, 7.0], [5.0, 6.0, 7.0]]))
    assert np.isnan(behind).all()
    np.testing.assert_allclose(depth, [-1.0, 0.0], atol=1e-14)


def test_windows_and_other_sizes_show_the_same_rays() -> None:
    pixels = np.array([[10.5, 7.5], [33.0, 40.0]])
    window, larger = CAMERA.cropped(8, 5, 30, 36), CAMERA.resized(128, 144)
    assert (window.width, window.height, larger.width, larger.height) == (30, 36, 128, 144)
    np.testing.assert_allclose(window.rays(pixels - [8, 5]), CAMERA.rays(pixels), atol=1e-15)
    np.testing.assert_allclose(larger.rays(pixels * [2, 3]), CAMERA.rays(pixels), atol=1e-15)


def test_a_picture_shows_what_lies_on_its_pixels_and_ahead() -> None:
    """Pixel i covers [i, i + 1): the left and upper border belong to it, the right and lower do not."""
    pixels = [
        [0, 0],
        [63.99, 47.99],
        [64, 20],
        [30, 48],
        [-0.01, 20],
        [30, -0.01],
        [30, 20],
        [30, 20],
        [np.nan, np.nan],
    ]
    z = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, -1.0, 1.0]
    assert CAMERA.shows(np.array(pixels), np.array(z)).tolist() == [True, True, *[False] * 7]


def test_a_grid_has_the_centres_of_pixels_row_by_row() -> None:
    assert pixel_grid((2, 3)).tolist() == [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5], [1.5, 1.5], [2.5, 1.5]]


def test_normalised_intrinsics_are_shares_of_the_picture() -> None:
    expected = [[50 / 64, 0, 30 / 64], [0, 40 / 48, 20 / 48], [0, 0, 1]]
    np.testing.assert_allclose(CAMERA.normalized_intrinsics, expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "value", "cure"),
    [
        ("width", 1, None),
        ("width", MAX_SIDE, None),
        ("width", MAX_SIDE + 1, "size of the photograph"),
        ("fx", 6.4, None),
        ("fx", 6.39, "these look normalised; multiply fx"),
        ("fx", 1280.0, None),
        ("fx", 1281.0, "give it in px of a picture of this very size"),
        ("fx", 1.0, "these look normalised; multiply fx by the image size, which would be 64 px"),
        ("fy", 0.1, "these look normalised; multiply fy by the image size, which would be 4.8 px"),
        ("fy", 0.09, "give it in px of a picture of this very size"),
        ("fx", 0.0, "focal lengths are positive"),
        ("fx", -50.0, "focal lengths are positive"),
        ("cx", -64.0, None),
        ("cx", 128.0, None),
        ("cx", 128.1, "if it is that of a larger picture"),
        ("cy", -48.1, "from the upper left corner"),
        ("cy", 96.1, "if it is that of a larger picture"),
    ],
)
def test_each_number_has_its_ends(name: str, value: float, cure: str | None) -> None:
    given = {"width": 64, "height": 48, "fx": 50.0, "fy": 40.0, "cx": 30.0, "cy": 20.0} | {name: value}
    if name == "width":
        given |= {"fx": value, "cx": value / 2}
    if cure is None:
        assert getattr(Camera.make(**given, world_from_cam=POSE), name) == value
        return
    with pytest.raises(CameraError if name == "width" else IntrinsicsError) as caught:
        Camera.make(**given, world_from_cam=POSE)
    assert caught.value.field == f"camera.{name}"
    assert name != "fx" or "for an image of 64 px, need between 6.4 and 1280 px" in caught.value.message
    assert cure in str(caught.value.cure)
    assert value > 0 or "larger picture" not in str(caught.value.cure)
