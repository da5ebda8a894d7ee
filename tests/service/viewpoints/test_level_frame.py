"""The frame for viewers: upright, about the pivot, scaled by its depth; pictures are the same as in the world's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import render
from gapmes.service.viewpoints.level_frame import LevelFrame
from gapmes.service.viewpoints.views import mean_camera, vertical


def cameras(turn: np.ndarray, shift: np.ndarray, unit: float) -> list[Camera]:
    """Two cameras that look slightly down at a common place, in a turned, moved and scaled world."""
    found = []
    for side in (-0.3, 0.3):
        pose = np.eye(4)
        pose[:3, :3] = turn @ about_axis(np.array([1.0, 0, 0]), -0.2) @ about_axis(np.array([0, 1.0, 0]), -side / 4)
        pose[:3, 3] = shift + unit * (turn @ np.array([side, 0.0, 0.0]))
        found.append(Camera.make(64, 48, 60.0, 60.0, 32.0, 24.0, pose))
    return found


WORLDS = [
    (np.eye(3), np.zeros(3), 1.0),
    (about_axis(np.array([1.0, 0, 0]), math.pi / 2), np.array([5e5, 4e6, 200.0]), 0.01),  # z up, far off, small
    (about_axis(np.array([0.6, 0.0, 0.8]), 2.5), np.array([-3.0, 1.0, 2.0]), 1e4),
]


@pytest.mark.parametrize(("turn", "shift", "unit"), WORLDS)
def test_it_is_level_and_looks_at_the_pivot(turn: np.ndarray, shift: np.ndarray, unit: float) -> None:
    views = cameras(turn, shift, unit)
    frame = LevelFrame.of(views, 4 * unit)
    assert np.allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)
    assert np.allclose(frame.rotation[:, 1], -vertical(views), atol=1e-12)  # y is down
    middle = frame.camera(mean_camera(views, 4 * unit))
    assert np.allclose(middle.center, -middle.rotation[:, 2], atol=1e-8)  # one unit before the origin, looking at it
    assert abs(middle.rotation[0, 2]) < 1e-12  # neither to the left nor to the right
    assert middle.rotation[2, 2] > 0


@pytest.mark.parametrize(("turn", "shift", "unit"), WORLDS)
def test_pictures_are_those_of_the_world(turn: np.ndarray, shift: np.ndarray, unit: float) -> None:
    """Means, scales, rotations and harmonics move together: the frame's picture is the world's."""
    rng = np.random.default_rng(3)
    views = cameras(turn, shift, unit)
    frame = LevelFrame.of(views, 4 * unit)
    count = 300
    means = shift + unit * (np.array([0, 0, 4.0]) + rng.normal(size=(count, 3))) @ turn.T
    gaussians = Gaussians.make(
        means,
        unit * rng.uniform(0.02, 0.2, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(0.2, 1, count),
        rng.normal(size=(count, 9, 3)) * 0.3,
    )
    here = render(gaussians, views[0], near=0.1 * unit)
    there = render(frame.gaussians(gaussians), frame.camera(views[0]), near=0.025)
    assert here.alpha.max() > 0.9
    assert np.abs(here.rgb - there.rgb).max() < 5e-6  # measured 4.3e-7: float32 of numbers that differ


def test_cameras_without_a_common_up_direction_have_a_frame() -> None:
    """Two that stand on their heads to each other and look the same way have no up but their mean rotation's."""
    poses = [np.eye(4), np.eye(4)]
    poses[1][:3, :3] = np.diag([-1.0, -1.0, 1.0])
    poses[1][0, 3] = 1.0
    frame = LevelFrame.of([Camera.make(64, 48, 60.0, 60.0, 32.0, 24.0, pose) for pose in poses], 2.0)
    assert np.allclose(frame.rotation[:, 2], [0, 0, 1], atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)


@pytest.mark.parametrize("seed", range(4))
def test_cameras_of_any_directions_have_a_frame_that_is_level(seed: int) -> None:
    """Their mean axis is then not at right angles to their mean up direction."""
    rng, poses = np.random.default_rng(seed), [np.eye(4) for _ in range(4)]
    for pose in poses:
        turn = rng.normal(size=3)
        pose[:3, :3] = about_axis(turn / np.linalg.norm(turn), rng.uniform(0, 1))
    views = [Camera.make(64, 48, 60.0, 60.0, 32.0, 24.0, pose) for pose in poses]
    frame = LevelFrame.of(views, 2.0)
    assert np.allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)
    assert np.allclose(frame.rotation[:, 1], -vertical(views), atol=1e-12)
    assert abs(mean_camera(views, 2.0).rotation[:, 2] @ vertical(views)) > 1e-3
