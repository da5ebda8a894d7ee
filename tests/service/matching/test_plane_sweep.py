"""The coarse plane sweep: planes as dense as parallax requires, batches without effect, masks."""

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import DEPTH, PlaneScene

from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.overlap import inverse_depth_steps
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.coarse_views import coarse_view, nearest_neighbours, warp_to
from gapmes.service.matching.plane_sweep import FEWEST, MOST_PLANES, STEP_PX, best_planes, plane_depths, step_px
from gapmes.service.matching.window_match import NOT_SEEN, correlations
from gapmes.service.photographs.images import Photo, fit_view

LEAST = 32
WIDE = DepthRange(0.3, 60.0, "estimated")


@pytest.fixture(scope="module")
def views():
    scene = PlaneScene.make(np.random.default_rng(4), turn=0.0)
    return [coarse_view(fit_view(Photo(i), c, 72, 96)) for i, c in zip(scene.images, scene.cameras, strict=True)]


def moves(cameras, depths):
    """(D - 1,) how far a place of a view moves inside its neighbour's picture from plane to plane, at most."""
    found = np.zeros(len(depths) - 1)
    for camera, j in zip(cameras, nearest_neighbours(cameras), strict=True):
        pixels = np.stack(np.meshgrid(np.linspace(0, 96, 33), np.linspace(0, 72, 25)), axis=-1).reshape(-1, 2)
        places = [cameras[j].project(camera.unproject(pixels, np.full(len(pixels), z)))[0] for z in depths]
        inside = (np.abs(np.array(places) - (48, 36)) <= (48, 36)).all(axis=2)
        far = np.linalg.norm(np.diff(places, axis=0), axis=2)
        found = np.maximum(found, np.where(inside[1:] & inside[:-1], far, 0.0).max(axis=1))
    return found


def test_planes_are_as_far_apart_as_the_step_says(views):
    cameras = [replace(view.camera, world_from_cam=view.camera.world_from_cam.copy()) for view in views]
    for camera in cameras:
        camera.world_from_cam[2, 3] = 0.0  # side by side: parallax is even in inverse depth
    apart = moves(cameras, plane_depths(cameras, WIDE, LEAST, STEP_PX))
    assert len(apart) > 2 * LEAST
    assert np.median(apart) > 0.9 * STEP_PX
    assert apart.max() <= STEP_PX
    tele = [replace(camera, fx=8 * camera.fx) for camera in cameras]  # across, where they move
    assert step_px(tele, WIDE) > STEP_PX
    assert (
        len(plane_depths(tele, WIDE, LEAST, STEP_PX))
        == len(plane_depths(tele, WIDE, LEAST, step_px(tele, WIDE)))
        == MOST_PLANES
    )
    tall = [replace(camera, fy=1.1 * camera.fy) for camera in cameras]
    assert len(plane_depths(tall, WIDE, LEAST, STEP_PX)) < 1.05 * len(apart)


def test_a_step_forward_is_parallax_too(views):
    camera = views[0].camera
    pose = camera.world_from_cam.copy()
    pose[2, 3] += 0.5
    pair = [camera, camera.posed(pose)]
    depths = plane_depths(pair, DepthRange(1.0, 60.0, "estimated"), 2, STEP_PX)
    apart = moves(pair, depths)
    assert len(depths) > 10
    assert apart.min() > 0.5 * STEP_PX
    assert apart.max() < 2 * STEP_PX  # at depth 1, where one camera is twice as close as the other


def test_cameras_that_look_at_one_place_have_planes_not_twice_as_far_apart(views):
    camera, angle = views[0].camera, np.deg2rad(45)
    pose = np.eye(4)
    pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), -angle)
    pose[:3, 3] = 4 * np.sin(angle), 0.0, 4 * (1 - np.cos(angle))
    pair = [camera.posed(np.eye(4)), camera.posed(pose)]
    depths = plane_depths(pair, DepthRange(1.0, 16.0, "estimated"), 2, STEP_PX)
    assert len(depths) > 20
    assert STEP_PX < moves(pair, depths).max() < 2 * STEP_PX


@pytest.mark.parametrize(
    ("size", "most"), [((64, 64), MOST_PLANES), ((64, 256), MOST_PLANES // 2), ((64, 4096), FEWEST)]
)
def test_larger_pictures_have_fewer_planes(views, size, most):
    pair = [view.camera.resized(size[1], size[0]) for view in views[:2]]
    endless = DepthRange(1e-30, 1e30, "given")
    assert (
        len(plane_depths(pair, endless, LEAST, STEP_PX))
        == len(plane_depths(pair, endless, LEAST, step_px(pair, endless)))
        == most
    )


def test_a_range_with_little_parallax_has_the_least_planes(views):
    cameras = [view.camera for view in views]
    near = DepthRange(3.9, 4.1, "given")
    np.testing.assert_array_equal(plane_depths(cameras, near, LEAST, STEP_PX), inverse_depth_steps(3.9, 4.1, LEAST))
    assert step_px(cameras, near) == STEP_PX
    endless = DepthRange(1e-30, 1e30, "given")
    assert len(plane_depths(cameras, endless, LEAST, step_px(cameras, endless))) == MOST_PLANES


def test_batches_find_what_all_planes_at_once_do(views):
    """The first third of the planes is too near to be seen at all."""
    view, other = views[:2]
    depths = inverse_depth_steps(0.2, 30.0, 100)
    warped, seen = warp_to(view.grey.shape, view.camera, other, depths)
    assert not seen[:32].any()
    scores = correlations(view.grey, warped, seen)
    best, found = best_planes(view, other, depths)
    np.testing.assert_array_equal(best, scores.max(axis=0))
    np.testing.assert_array_equal(found, depths[scores.argmax(axis=0)])
    best, found = best_planes(view, other, depths[:32])
    assert (best == NOT_SEEN).all()
    assert (found == depths[0]).all()


def test_coarse_views_hold_what_the_mask_keeps():
    scene = PlaneScene.make(np.random.default_rng(4), size=(256, 192))
    view = fit_view(Photo(scene.images[0]), scene.cameras[0], 192, 256)
    mask = np.ones((192, 256), np.bool_)
    mask[96:, :] = False
    mask[10:12, 12:14] = False  # a part of a cell
    mask[60:63, 30:33] = np.eye(3, dtype=bool)  # a third of one
    mask[63:66, 30:33] = False
    mask[63, 30:32] = True  # too little
    coarse = coarse_view(replace(view, mask=mask))
    expected = np.ones((64, 85), np.bool_)
    expected[32:] = False
    expected[21, 10] = False
    np.testing.assert_array_equal(coarse.kept, expected)
    part = view.image[:, 9:12, 12:15].mean(axis=0)[mask[9:12, 12:15]]
    assert coarse.grey[3, 4] == pytest.approx(part.mean(), abs=1e-6)
    whole = coarse_view(view)
    assert whole.kept.all()
    np.testing.assert_array_equal(whole.grey[:3], coarse.grey[:3])


def test_what_the_source_leaves_out_is_not_seen(views):
    kept = np.ones(views[1].grey.shape, np.bool_)
    kept[:, 40:] = False
    source = replace(views[1], kept=kept)
    shape, camera = views[0].grey.shape, views[0].camera
    _, seen = warp_to(shape, camera, source, np.array([DEPTH]))
    _, whole = warp_to(shape, camera, views[1], np.array([DEPTH]))
    pixels = np.stack([np.arange(shape[1]) + 0.5, np.full(shape[1], 36.5)], axis=1)
    there, _ = source.camera.project(camera.unproject(pixels, np.full(len(pixels), DEPTH)))
    left = there[:, 0] < 39.5  # centre of the last column that is kept
    assert 0.2 < left.mean() < 0.8
    np.testing.assert_array_equal(seen[0, 36], whole[0, 36] & left)
