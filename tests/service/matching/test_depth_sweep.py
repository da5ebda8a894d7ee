"""Narrowing the depth range by photographs of a plane of known depth."""

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import DEPTH, PlaneScene

from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.coarse_views import coarse_view, nearest_neighbours
from gapmes.service.matching.depth_sweep import COARSE_PX, coarse_notices, depths_of_matches, narrowed, planes_apart_px
from gapmes.service.photographs.images import Photo, fit_view


def fitted(scene):
    return [fit_view(Photo(i), c, 72, 96) for i, c in zip(scene.images, scene.cameras, strict=True)]


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_the_range_closes_in_on_the_plane(turn):
    scene = PlaneScene.make(np.random.default_rng(3), turn=turn)
    wide = depth_range(scene.cameras)
    result = narrowed(wide, fitted(scene))
    assert result.source == "estimated"
    # the plane spans z = 3.5 to 4.6 over the turned views
    assert 0.6 * 3.2 < result.near < 0.6 * 4.6
    assert 1.5 * 3.5 < result.far < 1.5 * 5.2
    assert wide.near <= result.near
    assert result.far <= wide.far


def test_matched_depths_are_those_of_the_plane():
    scene = PlaneScene.make(np.random.default_rng(4), turn=0.0)
    found, weights, share = depths_of_matches(
        [coarse_view(view) for view in fitted(scene)], DepthRange(1.0, 30.0, "estimated")
    )
    assert share > 0.4
    assert (weights > 0).all()
    # half a step of 64 planes in inverse depth is 12 % at z = 4, and the third camera stands 0.2 nearer
    assert np.percentile(found, 10) > DEPTH * 0.85
    assert np.percentile(found, 90) < DEPTH * 1.15


def test_a_wide_range_is_swept_as_finely():
    """Of 64 planes none would be nearer to the scene than 3.4 and 4.8, of the 200 that its 300 px need some are."""
    scene = PlaneScene.make(np.random.default_rng(4), turn=0.0)
    coarse = [coarse_view(view) for view in fitted(scene)]
    _, _, share = depths_of_matches(coarse, DepthRange(1.0, 30.0, "estimated"))
    found, _, of_wide = depths_of_matches(coarse, DepthRange(0.182, 30.0, "estimated"))
    assert of_wide > 0.9 * share
    assert np.percentile(found, 10) > DEPTH * 0.85
    assert np.percentile(found, 90) < DEPTH * 1.15


@pytest.mark.parametrize("rows", [slice(120, None), slice(0, 150)])
def test_masked_pixels_have_no_say(rows):
    """Where both masks end at one place nothing matches for that; a part of a view that is kept is enough."""
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192))
    wide = depth_range(scene.cameras)
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(scene.images, scene.cameras, strict=True)]
    mask = np.ones((192, 256), np.bool_)
    mask[rows] = False
    ranges = []
    for fill in (0.0, 1.0, 0.5):
        image = [np.where(mask, view.image, np.float32(fill)) for view in views]
        result = narrowed(wide, [replace(v, image=i, mask=mask) for v, i in zip(views, image, strict=True)])
        ranges.append((result.near, result.far))
    assert ranges[0] == ranges[1] == ranges[2]
    near, far = ranges[0]
    assert 0.6 * 3.0 < near < 0.6 * 4.6
    assert 1.5 * 3.5 < far < 1.5 * 5.2


def test_a_mask_that_leaves_too_little_of_every_cell_leaves_the_range():
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192))
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(scene.images, scene.cameras, strict=True)]
    mask = np.zeros((192, 256), np.bool_)
    mask[::3, ::3] = True
    wide = depth_range(scene.cameras)
    assert narrowed(wide, [replace(view, mask=mask) for view in views]) is wide


def test_the_range_moves_with_the_unit():
    scene = PlaneScene.make(np.random.default_rng(3))
    result = narrowed(depth_range(scene.cameras), fitted(scene))
    moved = scene.moved(np.eye(3), np.array([1e4, 0.0, -3e4]), 100.0)
    scaled = narrowed(depth_range(moved.cameras), fitted(moved))
    assert scaled.near == pytest.approx(100 * result.near, rel=1e-6)
    assert scaled.far == pytest.approx(100 * result.far, rel=1e-6)


def test_a_given_range_stays():
    given = DepthRange(0.5, 1000.0, "given")
    assert narrowed(given, fitted(PlaneScene.make(np.random.default_rng(3)))) is given


def test_without_matches_the_range_stays():
    scene = PlaneScene.make(np.random.default_rng(3))
    flat = replace(scene, images=tuple(np.full_like(image, 90) for image in scene.images))
    wide = depth_range(scene.cameras)
    assert narrowed(wide, fitted(flat)) is wide


def test_nearest_neighbours():
    first, second, third = PlaneScene.make(np.random.default_rng(3)).cameras
    assert nearest_neighbours([first, second, third])[::2] == [1, 1]
    assert nearest_neighbours([third, first, second])[:2] == [2, 2]


@pytest.mark.parametrize("apart", [0.0, 1e-3])
def test_a_neighbour_has_parallax(apart):
    """Two cameras at one place, turned: both are compared with the third, and it with either."""
    first, second, _ = PlaneScene.make(np.random.default_rng(3)).cameras
    pose = first.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), 0.1)
    pose[0, 3] += apart
    assert nearest_neighbours([first, first.posed(pose), second])[:2] == [2, 2]


LEAST_NEAR, MOST_FAR = 0.6 * 3.0, 1.5 * 5.2  # where both ends are drawn in


@pytest.mark.parametrize(
    ("near", "planes", "told", "far"), [(2.0, 16, False, 30.0), (0.3, 12, True, 30.0), (0.3, 6, True, None)]
)
def test_a_given_range_is_narrowed_where_the_planes_would_stand_far_apart(near, planes, told, far):
    """Its far end, where much may lie that has little contrast, only if the near one is not enough."""
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192))
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(scene.images, scene.cameras, strict=True)]
    given = DepthRange(near, 30.0, "given")
    apart = planes_apart_px(given, views, planes)
    assert (apart > COARSE_PX) == told
    result = narrowed(given, views, planes)
    notices = coarse_notices(given, result, views, planes)
    assert (result.source == "narrowed") == (result != given) == told == bool(notices)
    if far is None:
        assert 1.5 * 3.5 < result.far < MOST_FAR
    else:
        assert result.far == far
    if told:
        assert LEAST_NEAR < result.near < 0.6 * 4.6
        (notice,) = notices
        assert (notice["code"], notice["field"]) == ("depth_range_coarse", "near")
        words = f"between near = 0.3 and far = 30 the network's {planes} depths stand {apart:.3g} px"
        assert words in notice["message"]
        assert f"from {result.near:.4g} to {result.far:.4g}" in notice["message"]


def test_a_right_range_of_cameras_far_apart_stays_without_a_word():
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192))
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(scene.images, scene.cameras, strict=True)]
    given = DepthRange(0.6 * 3.4, 1.5 * 4.7, "given")
    assert planes_apart_px(given, views, 3) > COARSE_PX
    assert narrowed(given, views, 3) == given
    assert coarse_notices(given, given, views, 3) == []


def test_planes_stand_as_far_apart_as_a_point_moves():
    """Sideways cameras of one lens: f B (1 / near - 1 / far) / (planes - 1)."""
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192), turn=0.0, count=2)
    one = fit_view(Photo(scene.images[0]), scene.cameras[0], 192, 256)
    pose = np.eye(4)
    pose[:3, 3] = one.camera.center + np.array([0.5, 0.0, 0.0])
    views = [one, replace(one, camera=one.camera.posed(pose))]
    expected = one.camera.fx * 0.5 * (1 / 2 - 1 / 30) / 63
    assert planes_apart_px(DepthRange(2.0, 30.0, "given"), views, 64) == pytest.approx(expected)


def test_a_coarse_range_stays_where_nothing_matches():
    scene = PlaneScene.make(np.random.default_rng(3), size=(256, 192))
    noise = [np.random.default_rng(k).integers(0, 256, image.shape, np.uint8) for k, image in enumerate(scene.images)]
    views = [fit_view(Photo(i), c, 192, 256) for i, c in zip(noise, scene.cameras, strict=True)]
    given = DepthRange(0.1, 30.0, "given")
    assert planes_apart_px(given, views, 16) > COARSE_PX
    assert narrowed(given, views, 16) == given
    assert coarse_notices(given, given, views, 16) == []
