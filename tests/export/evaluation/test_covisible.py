"""Co-visibility against brute force: rays from the inputs to the surface of an analytic scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_scenes import StepScene, camera_at

from gapmes.export.evaluation.covisible import TRUE_TOLERANCE, covisible

SCENE = StepScene(3.0, slab=1.5, half_width=0.3)


def sees(camera_x: float, point: np.ndarray) -> bool:
    """Whether a camera at (camera_x, 0, 0) sees a point: it lies in the picture, and the slab does not hide it."""
    camera = camera_at(camera_x)
    pixels, z = camera.project(point[None])
    if z[0] <= 0 or not (0 <= pixels[0, 0] < camera.width and 0 <= pixels[0, 1] < camera.height):
        return False
    crossing = camera_x + (point[0] - camera_x) * SCENE.slab / point[2]
    return bool(point[2] <= SCENE.slab + 1e-6 or abs(crossing) >= SCENE.half_width)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_is_what_rays_say(side: float) -> None:
    target = camera_at(0.0)
    inputs = [camera_at(0.25 * side), camera_at(0.5 * side)]
    depth = SCENE.depth(target)
    mask = covisible(target, depth, inputs, [SCENE.depth(camera) for camera in inputs], TRUE_TOLERANCE)
    expected = np.zeros_like(mask)
    for row in range(64):
        for column in range(64):
            point = target.unproject(np.array([[column + 0.5, row + 0.5]]), depth[row, column].astype(np.float64)[None])
            expected[row, column] = any(sees(camera.center[0], point[0]) for camera in inputs)
    assert 0.02 < (~expected).mean() < 0.5
    assert (mask == expected).all()  # half a pixel beside it one column differs, on one side


def test_background_is_a_direction_that_an_input_sees_where_it_has_background_itself() -> None:
    """Camera two units farther back, as after a step forward: sky has no parallax, whatever depth it is given."""
    target = camera_at(0.0)
    behind = target.world_from_cam.copy()
    behind[2, 3] = -2.0
    back = replace(target, world_from_cam=behind)
    sky = np.full((64, 64), np.inf, np.float32)
    assert covisible(target, sky, [back], [sky], TRUE_TOLERANCE).all()
    finite = np.full((64, 64), 9.0, np.float32)
    assert not covisible(target, finite, [back], [finite], TRUE_TOLERANCE).any()  # what `far` in its place would say
    roof = sky.copy()
    roof[:20] = 3.0  # covers what the target sees in the same pixels, since directions do not move
    mask = covisible(target, sky, [back], [roof], TRUE_TOLERANCE)
    assert not mask[:20].any()
    assert mask[20:].all()
    half = camera_at(0.0)
    turned = replace(half, world_from_cam=half.world_from_cam @ np.diag([-1.0, 1.0, -1.0, 1.0]))  # looks the other way
    assert not covisible(target, sky, [turned], [sky], TRUE_TOLERANCE).any()


def test_views_see_what_they_see_themselves_and_not_what_lies_behind() -> None:
    camera = camera_at(0.0)
    depth = SCENE.depth(camera)
    assert covisible(camera, depth, [camera], [depth], TRUE_TOLERANCE).all()
    assert covisible(camera, 1.019 * depth, [camera], [depth], TRUE_TOLERANCE).all()
    assert not covisible(camera, 1.021 * depth, [camera], [depth], TRUE_TOLERANCE).any()
    assert not covisible(camera, depth, [camera_at(100.0)], [depth], TRUE_TOLERANCE).any()
