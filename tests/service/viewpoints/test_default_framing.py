"""The default camera by its equations, and the depths that cameras see."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.errors import GaussiansError
from gapmes.service.gaussians import Gaussians
from gapmes.service.viewpoints.default_framing import default_views
from gapmes.service.viewpoints.seen_depths import seen_depths

CENTRE = np.array([1.0, -2.0, 30.0])
HALF_ANGLE = math.radians(25)


def gaussians(means: object, opacities: object = 0.5, scale: float = 0.1) -> Gaussians:
    means = np.array(means, dtype=np.float64)
    count = len(means)
    scales = np.full((count, 3), scale) * [1.0, 0.5, 0.25]
    shown = np.broadcast_to(np.asarray(opacities, dtype=np.float64), count)
    return Gaussians.make(means, scales, [[1, 0, 0, 0]] * count, shown, np.zeros((count, 1, 3)))


def row(*places: float) -> np.ndarray:
    return CENTRE + np.array(places)[:, None] * [1.0, 0.0, 0.0]


def assert_frames(found: Gaussians, radius: float) -> None:
    """The sphere about CENTRE, from where it fits into 50 degrees, with the geometric mean of near and far at it."""
    views = default_views(found)
    [camera] = views.cameras
    distance = radius / math.sin(HALF_ANGLE)
    np.testing.assert_allclose(camera.center, CENTRE - [0, 0, distance], rtol=1e-6)
    np.testing.assert_array_equal(camera.rotation, np.eye(3))
    assert (views.far, views.near) == (
        pytest.approx(distance + radius, rel=1e-6),
        pytest.approx(distance**2 / (distance + radius), rel=1e-6),
    )
    rim = CENTRE + radius * np.array([math.cos(HALF_ANGLE), 0.0, -math.sin(HALF_ANGLE)])  # where a tangent touches
    pixels, _ = camera.project(np.stack([CENTRE, rim]))
    np.testing.assert_allclose(pixels, [[256, 256], [512, 256]], atol=1e-3)


@pytest.mark.parametrize("opacity", [0.5, 0.0])
def test_the_sphere_of_four_fifths_is_framed(opacity: float) -> None:
    """Of eleven in a row nine lie within 4 of the middle one; without opacity all count alike."""
    assert_frames(gaussians(row(*range(-5, 6)), opacity), 4.0)


def test_what_is_faint_counts_little() -> None:
    faint, bright = row(50, 60, 70, 80, 90, 100, 110), row(-1, 0, 1)
    assert_frames(gaussians(np.vstack([faint, bright]), [0.001] * 7 + [0.9] * 3), 1.0)


@pytest.mark.parametrize(("scale", "radius"), [(0.2, 0.6), (0.0, 1.0)])
def test_a_single_place_is_framed_by_three_standard_deviations(scale: float, radius: float) -> None:
    assert_frames(gaussians(row(0, 0, 0), scale=scale), radius)


def test_the_farthest_is_named_where_no_camera_can_hold_them() -> None:
    with pytest.raises(GaussiansError, match=r"the farthest is at index 2: \[0\.0, -3e\+101, 0\.0\]") as caught:
        default_views(gaussians([[0, 0, 0], [1e101, 0, 0], [0, -3e101, 0], [0, 0, 2e101]]))
    assert (caught.value.field, caught.value.index) == ("means", 2)


def test_seen_depths_are_those_of_what_projects_into_a_picture() -> None:
    """From 1 to 101 ahead: the first and the last per cent left out; what is beside or behind is not seen."""
    ahead = [[0.0, 0.0, 1.0 + z] for z in range(101)]
    others = [[500.0, 0.0, 3.0], [0.0, -500.0, 3.0], [0.0, 0.0, -7.0]]
    camera = Camera.make(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    assert seen_depths(gaussians([*others, *ahead]), [camera]) == pytest.approx((2.0, 100.0))
    assert seen_depths(gaussians(others), [camera]) is None
    assert seen_depths(gaussians(ahead), []) is None
