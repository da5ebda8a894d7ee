"""Derivatives of distances from epipolar lines by changes of either camera, against central differences."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.epipolar import CHANGES, SHIFT, TURN, ZOOM, lines_across, longest_baseline

UNIT = 1.7
STEP = 1e-5
TOLERANCE = 1e-6  # measured 2e-8 px of slopes of up to 350 px: positions of 300 px are rounded to 6e-14, over STEP


def looking(center: tuple[float, float, float], axis: tuple[float, float, float], degrees: float) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = about_axis(np.array(axis) / np.linalg.norm(axis), np.radians(degrees))
    pose[:3, 3] = center
    return Camera(width=320, height=240, fx=290.0, fy=310.0, cx=150.0, cy=126.0, world_from_cam=pose)


VIEW, OTHER = looking((0.3, -0.2, 0.1), (1, 2, 3), 20), looking((1.2, 0.4, -0.5), (2, -1, 1), 12)


def changed(camera: Camera, kind: int, step: float) -> Camera:
    """Turned about an axis of the world, moved along one in UNITs, or zoomed, by the change of number `kind`."""
    amounts = np.zeros(CHANGES)
    amounts[kind] = step
    pose = camera.world_from_cam.copy()
    pose[:3, :3] = about_axis(np.eye(3)[kind % 3], amounts[TURN].sum()) @ pose[:3, :3]
    pose[:3, 3] += UNIT * amounts[SHIFT]
    zoom = np.exp(amounts[ZOOM])
    return replace(camera, fx=camera.fx * zoom, fy=camera.fy * zoom, world_from_cam=pose)


def surface() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform((0, 0), (VIEW.width, VIEW.height), (50, 2)), rng.uniform(2.0, 9.0, 50)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("kind", range(CHANGES))
def test_slopes_are_differences(kind: int, which: int) -> None:
    """What was matched stays where it is in the picture, while the point and its line move."""
    pixels, depth = surface()
    matched, _ = OTHER.project(VIEW.unproject(pixels, depth))
    distances = []
    for step in (-STEP, STEP):
        cameras = [changed(camera, kind, step) if at == which else camera for at, camera in enumerate((VIEW, OTHER))]
        there, _ = cameras[1].project(cameras[0].unproject(pixels, depth))
        normals, _ = lines_across(*cameras, pixels, depth, UNIT)
        distances.append(((matched - there) * normals).sum(axis=1))
    _, slopes = lines_across(VIEW, OTHER, pixels, depth, UNIT)
    expected = (distances[1] - distances[0]) / (2 * STEP)
    assert np.abs(slopes[:, which, kind] - expected).max() < TOLERANCE
    assert np.abs(expected).max() > 1.0


def test_a_change_of_depth_is_not_across_the_line() -> None:
    pixels, depth = surface()
    normals, _ = lines_across(VIEW, OTHER, pixels, depth, UNIT)
    near, far = (OTHER.project(VIEW.unproject(pixels, scale * depth))[0] for scale in (0.9, 1.5))
    assert np.abs(((far - near) * normals).sum(axis=1)).max() < 1e-10
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(50), abs=1e-12)


def test_the_unit_of_shifts_is_there_where_float64_hardly_holds_it() -> None:
    """Such cameras may be given, with near and far: what is measured refuses none."""
    pose = VIEW.world_from_cam.copy()
    pose[:3, 3] += [1e13, 0.0, 0.0]
    moved = pose.copy()
    moved[0, 3] += 0.15
    views = [SimpleNamespace(camera=VIEW.posed(each)) for each in (pose, moved)]
    assert 0.1 < longest_baseline(views) < 0.2


def test_both_cameras_in_one_place_have_no_lines() -> None:
    pixels, depth = surface()
    turned = changed(VIEW, 1, 0.1)
    normals, slopes = lines_across(VIEW, turned, pixels, depth, UNIT)
    assert not normals.any()
    assert not slopes.any()
