"""One photograph under two poses is recognised by its pixels, also in another encoding; near-static frames are not."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from plane_scene import photograph
from sample_photographs import FAR, NEAR, sample_cameras, sample_pixels, sample_views

from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.errors import ContradictionError
from gapmes.service.matching.duplicates import duplicates, least_motion_px
from gapmes.service.matching.photo_checks import check_photos
from gapmes.service.photographs.images import Photo, fit_view

DEPTHS = DepthRange(2.0, 8.0, "given")
SAMPLE = DepthRange(NEAR, FAR, "given")


def fitted(scene, size=(72, 96)):
    return [fit_view(Photo(i), c, *size) for i, c in zip(scene.images, scene.cameras, strict=True)]


def encoded(pixels, quality):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def test_one_photograph_for_two_poses_is_refused(plane_scene):
    views = fitted(plane_scene)
    doubled = [views[0], replace(views[1], image=views[0].image), *views[2:]]
    with pytest.raises(ContradictionError, match="photographs 4 and 7 are the same picture") as caught:
        check_photos(doubled, DEPTHS, numbers=[4, 7, 8, 9][: len(views)])
    assert (caught.value.field, caught.value.index) == ("images", 7)
    notices = check_photos(doubled, DEPTHS, trust_poses=True)
    assert notices[0]["code"] == "photos_equal"
    plain = [replace(view, image=np.full_like(view.image, 0.5)) for view in views]  # show nothing that could differ
    assert [notice["code"] for notice in check_photos(plain, DEPTHS)] == ["no_texture"]


@pytest.mark.parametrize("qualities", [(95, 90), (92, 96)])
@pytest.mark.parametrize("pair", [(1, 5), (0, 7)])
@pytest.mark.parametrize("given", [True, False])
def test_one_photograph_in_two_encodings_is_told(qualities, pair, given):
    pixels, cameras = sample_pixels(pair[0]), sample_cameras(pair)
    views = [fit_view(Photo(encoded(pixels, q)), c, 256, 256) for q, c in zip(qualities, cameras, strict=True)]
    (notice,) = duplicates(views, SAMPLE if given else depth_range(cameras), (3, 8), False)
    assert (notice["code"], notice["field"], notice["index"]) == ("photos_equal", "images", 8)
    assert "photographs 3 and 8 differ by 2." in notice["message"]
    assert "was one of them sent twice?" in notice["message"]


def test_neighbouring_photographs_are_no_twins():
    for one in range(7):
        views = sample_views((one, one + 1))
        estimate = depth_range([view.camera for view in views])
        assert duplicates(views, SAMPLE, (0, 1), False) == duplicates(views, estimate, (0, 1), False) == []


@pytest.mark.parametrize("step", [0.001, 0.003, 0.01, 0.03, 0.1])
def test_frames_of_a_clip_that_hardly_move_are_no_twins(step, plane_scene):
    """At 90 px of focal length and 4 units of depth they move by 0.02 to 2 px."""
    rng, lens, views = np.random.default_rng(5), plane_scene.cameras[0], []
    waves, phases = rng.normal(size=(3, 24, 2)) * 3, rng.uniform(0, 2 * np.pi, (3, 24))
    for index in range(2):
        pose = np.eye(4)
        pose[0, 3] = step * index
        camera = lens.posed(pose)
        views.append(fit_view(Photo(photograph(camera, waves, phases)), camera, 72, 96))
    assert duplicates(views, DEPTHS, (0, 1), False) == []
    assert duplicates(views, depth_range([view.camera for view in views]), (0, 1), False) == []


def test_pictures_without_texture_are_no_twins(plane_scene):
    """A ramp down the picture with noise of one level, under cameras that stand side by side."""
    rng, ramp = np.random.default_rng(2), np.linspace(0.2, 0.8, 72, dtype=np.float32)[:, None]
    views = [
        replace(view, image=ramp + rng.uniform(-0.5 / 255, 0.5 / 255, view.image.shape).astype(np.float32))
        for view in fitted(plane_scene)
    ]
    assert least_motion_px(views[0].camera, views[2].camera, DEPTHS) > 2
    assert duplicates(views, DEPTHS, (0, 1, 2), False) == []


def test_only_what_both_masks_keep_is_compared():
    pixels, cameras = sample_pixels(1), sample_cameras((1, 5))
    views = [fit_view(Photo(encoded(pixels, q)), c, 256, 256) for q, c in zip((95, 90), cameras, strict=True)]
    mask = np.ones((256, 256), np.bool_)
    mask[:, 128:] = False
    half = [views[0], replace(views[1], image=np.where(mask, views[1].image, np.float32(0)), mask=mask)]
    assert len(duplicates(half, SAMPLE, (0, 1), False)) == 1
    apart = [replace(views[0], mask=~mask), half[1]]
    assert duplicates(apart, SAMPLE, (0, 1), False) == []


def test_the_least_motion_is_that_of_the_far_end_between_parallel_cameras(plane_scene):
    one = plane_scene.cameras[0].posed(np.eye(4))
    pose = np.eye(4)
    pose[0, 3] = 0.4
    moved = least_motion_px(one, one.posed(pose), DEPTHS)
    assert moved == pytest.approx(one.fx * 0.4 / 8.0)
    pose[:3, :3] = one.rotation  # an estimated range has no end
    assert least_motion_px(one, one.posed(pose), DepthRange(2.0, 8.0, "estimated")) < 0.01
