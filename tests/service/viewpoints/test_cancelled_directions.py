"""Cameras whose directions cancel, such as those around an object: paths go round it, whatever the world's axes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from camera_sets import PIVOT, UP, arc, camera, moves_with_the_world, ring

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.viewpoints.camera_path import PATHS, camera_path, loop
from gapmes.service.viewpoints.level_frame import LevelFrame
from gapmes.service.viewpoints.views import mean_camera, vertical

SETS = {
    "two opposite": ring(2, 0.0),
    "ring": ring(12),
    "level ring": ring(8, 0.0),
    "most of a ring": ring(12, 0.0)[1:],
    "wide arc": arc(80),
    "outwards": [camera(one.rotation, np.zeros(3)) for one in ring(8)],
    "upside down to each other": [camera(np.eye(3), [0.0, 0, 0]), camera(np.diag([-1.0, -1.0, 1.0]), [1.0, 0, 0])],
}


@pytest.mark.parametrize("cameras", SETS.values(), ids=SETS)
@pytest.mark.parametrize("name", PATHS)
def test_paths_of_cameras_whose_directions_cancel_move_with_the_world(cameras, name):
    """Rounding does not decide where they look."""
    for scale in (1e-3, 1e3):
        moves_with_the_world(cameras, scale, name)


@pytest.mark.parametrize("which", ["two opposite", "ring", "level ring", "most of a ring", "wide arc"])
@pytest.mark.parametrize("name", ["turntable", "orbit"])
def test_cameras_around_an_object_are_followed_around_it(which, name):
    """From as far as they stand, and at their height; nobody looks from within."""
    cameras = SETS[which]
    for shot in loop(camera_path(name, cameras, pivot_depth=PIVOT), 12):
        assert np.linalg.norm(shot.center) == pytest.approx(PIVOT)
        np.testing.assert_allclose(shot.rotation[:, 2], -shot.center / PIVOT, atol=1e-9)
        assert shot.center @ UP == pytest.approx(cameras[0].center @ UP)


def test_cameras_that_look_apart_are_followed_from_their_middle():
    cameras = [camera(about_axis(UP, a), [math.sin(a), 0.0, math.cos(a)]) for a in (-0.5, 0.2, 0.5)]
    center = np.mean([one.center for one in cameras], axis=0)
    np.testing.assert_allclose(mean_camera(cameras, PIVOT).center, center, atol=1e-12)


def test_up_directions_that_cancel_up_to_rounding_have_the_vertical_of_the_mean_rotation():
    """Quarter turns about their common axis: their up directions have a sum of 1e-16."""
    cameras = [
        camera(about_axis(np.array([0.0, 0, 1]), a), [x, 0, 0]) for x, a in enumerate(math.pi / 2 * np.arange(4))
    ]
    length = np.linalg.norm(np.mean([one.rotation[:, 1] for one in cameras], axis=0))
    assert 0 < length < 1e-15
    np.testing.assert_allclose(vertical(cameras), -cameras[0].rotation[:, 1], atol=1e-15)


def test_cameras_that_look_along_their_vertical_have_a_frame():
    """Their mean rotation is the identity, and their up directions have a mean of (0, 0, -1/9)."""
    upright, over = np.eye(3), np.diag([1.0, -1.0, -1.0])
    rolled, turned = np.diag([-1.0, -1.0, 1.0]), np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    cameras = [camera(one, np.zeros(3)) for one in (*[upright, over] * 2, *[upright, rolled] * 2, turned)]
    np.testing.assert_allclose(mean_camera(cameras, PIVOT).rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(vertical(cameras), [0, 0, -1], atol=1e-12)
    frame = LevelFrame.of(cameras, PIVOT)
    np.testing.assert_allclose(frame.rotation, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
