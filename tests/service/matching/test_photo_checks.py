"""Whether photographs agree with cameras: rendered photographs of a plane, under correct and wrong poses."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from plane_scene import DEPTH, ROBOT, PlaneScene
from sample_photographs import sample_cameras, sample_views

from gapmes.service.cameras.depth_range import DepthRange, depth_range
from gapmes.service.cameras.pose import rigid_inverse
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.errors import ContradictionError
from gapmes.service.matching import photo_checks
from gapmes.service.matching.coarse_views import coarse_view, warp_to
from gapmes.service.matching.photo_checks import check_photos, consistency
from gapmes.service.matching.plane_sweep import MOST_PLANES, STEP_PX
from gapmes.service.matching.window_match import RADIUS, correlations, match_score, window_mean
from gapmes.service.photographs.images import Photo, fit_view
from gapmes.service.shipped import sample_folder

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
DEPTHS = DepthRange(2.0, 8.0, "given")
WRONG = {
    "world-to-camera matrices: ": rigid_inverse,
    "OpenGL axes": lambda pose: pose @ FLIP,
    "world-to-camera matrices in OpenGL axes": lambda pose: rigid_inverse(pose @ FLIP),
    "look like a robot's axes (x forward, y left, z up)": lambda pose: pose @ ROBOT,
    "look like a robot's axes (x forward, y right, z down)": lambda pose: pose @ ROBOT @ FLIP,
}


def fitted(scene, change=lambda pose: pose, size=(72, 96)):
    views = [fit_view(Photo(i), c, *size) for i, c in zip(scene.images, scene.cameras, strict=True)]
    return [replace(v, camera=v.camera.posed(change(v.camera.world_from_cam))) for v in views]


@pytest.fixture(scope="module")
def off_origin(plane_scene):
    """The plane in a world whose origin is elsewhere and whose axes are turned, as in any real file."""
    return plane_scene.moved(about_axis(np.array([0.6, 0.0, 0.8]), 1.2), np.array([5.0, -3.0, 8.0]), 1.0)


def test_right_poses_pass(plane_scene, off_origin):
    assert check_photos(fitted(plane_scene), DEPTHS) == []
    assert check_photos(fitted(off_origin), DEPTHS) == []


@pytest.mark.parametrize("shape", ["wide", "stretched"])
def test_right_poses_of_wide_photographs_pass(shape):
    """Their crops show a small part of what the photographs share, so that much parallax is in the estimated range."""
    views, cameras = [], []
    for index, camera in zip((1, 5), sample_cameras((1, 5)), strict=True):
        with Image.open(sample_folder() / "images" / f"{index:03d}.png") as image:
            if shape == "wide":
                image, camera = image.crop((0, 60, 256, 140)), camera.cropped(0, 60, 256, 80)
            else:
                image, camera = image.resize((2048, 256)), camera.resized(2048, 256)
            photo = Photo.from_array(np.asarray(image.convert("RGB")))
        views.append(fit_view(photo, camera, 256, 256))
        cameras.append(camera)
    assert check_photos(views, depth_range(cameras)) == []


def test_no_reading_is_swept_by_finer_steps_than_the_poses(plane_scene, monkeypatch):
    steps = []

    def noted(views, cameras, depths, step):
        steps.append(step)
        return consistency(views, cameras, depths, step)

    monkeypatch.setattr(photo_checks, "consistency", noted)
    check_photos(fitted(plane_scene), DEPTHS)
    assert set(steps) == {STEP_PX}
    steps.clear()
    check_photos(fitted(plane_scene)[:2], DepthRange(0.05, 100.0, "given"), trust_poses=True)
    assert len(set(steps)) == 1
    assert steps[0] > 2 * STEP_PX
    assert MOST_PLANES * steps[0] > 0.5 * 90 / 0.05  # px


def test_masked_pixels_have_no_say(plane_scene):
    """Where both masks end at one place nothing matches for that."""
    views = fitted(plane_scene, size=(192, 256))
    mask = np.ones((192, 256), np.bool_)
    mask[120:] = False
    scores = []
    for fill in (0.0, 1.0, 0.5):
        masked = [replace(view, image=np.where(mask, view.image, np.float32(fill)), mask=mask) for view in views]
        coarse = [coarse_view(view) for view in masked]
        scores.append(consistency(coarse, [view.camera for view in coarse], DEPTHS))
    assert scores[0] == scores[1] == scores[2] > 0.9


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_readings_are_named(off_origin, wrong):
    with pytest.raises(ContradictionError, match="match with score") as caught:
        check_photos(fitted(off_origin, WRONG[wrong]), DEPTHS)
    assert wrong in caught.value.cure
    assert caught.value.extra["other_score"] > caught.value.extra["score"] + 0.15


def test_a_wrong_reading_is_a_warning_where_poses_are_trusted(off_origin):
    """Whichever reading it is: the orders below are others."""
    (notice,) = check_photos(fitted(off_origin, WRONG["OpenGL axes"]), DEPTHS, trust_poses=True)
    assert notice["code"] == "poses_doubtful"
    assert "OpenGL axes" in notice["message"]


def test_swapped_cameras_of_two_photographs_are_noticed():
    scene = PlaneScene.make(np.random.default_rng(5), count=2, turn=0)
    views = fitted(scene)
    swapped = [replace(v, camera=o.camera) for v, o in zip(views, reversed(views), strict=True)]
    assert check_photos(views, DEPTHS) == []
    with pytest.raises(ContradictionError) as caught:
        check_photos(swapped, DEPTHS)
    assert "the cameras of the other photograph" in caught.value.cure


@pytest.mark.parametrize(
    ("order", "cure"),
    [
        ((1, 0, 2), "photograph 4 fits that of 7, 7 fits that of 4"),
        ((0, 2, 1), "photograph 7 fits that of 9, 9 fits that of 7"),
        ((2, 1, 0), "photograph 4 fits that of 9, 9 fits that of 4"),
        ((1, 2, 0), "photograph 4 fits that of 9, 7 fits that of 4, 9 fits that of 7"),
        ((2, 0, 1), "photograph 4 fits that of 7, 7 fits that of 9, 9 fits that of 4"),
    ],
)
def test_cameras_of_three_photographs_in_another_order_are_named(order, cure):
    """`order` is which camera each was sent with."""
    views = sample_views((1, 3, 5))
    mixed = [replace(view, camera=views[place].camera) for view, place in zip(views, order, strict=True)]
    depths = depth_range([view.camera for view in mixed])
    (notice,) = check_photos(mixed, depths, trust_poses=True, numbers=(4, 7, 9))
    assert notice["code"] == "poses_doubtful"
    assert "these look like the cameras of other photographs: send each photograph with its own" in notice["message"]
    assert f"{cure})" in notice["message"]


@pytest.mark.parametrize("indices", [(1, 3, 5), (2, 3, 4), (0, 3, 6)])
def test_right_orders_pass(indices):
    views = sample_views(indices)
    assert check_photos(views, depth_range([view.camera for view in views])) == []


@pytest.mark.parametrize("indices", [(2, 3, 4), (0, 3, 6)])
def test_wrong_orders_of_close_and_of_wide_views_are_noticed(indices):
    views = sample_views(indices)
    noticed = 0
    for order in ((1, 0, 2), (0, 2, 1), (2, 1, 0), (1, 2, 0), (2, 0, 1)):
        mixed = [replace(view, camera=views[place].camera) for view, place in zip(views, order, strict=True)]
        noticed += len(check_photos(mixed, depth_range([view.camera for view in mixed]), trust_poses=True))
    assert noticed >= 4  # measured 5 and 5


@pytest.mark.parametrize("bounds", [(4.0, 50.0), (8.0, 100.0)])
def test_wrong_bounds_are_not_taken_for_a_wrong_order(bounds):
    """Of many orders some one matches a little better by chance."""
    (notice,) = check_photos(sample_views((1, 3, 5)), DepthRange(*bounds, "given"))
    assert notice["code"] == "depth_range_doubtful"
    assert "give near and far in the unit of the poses" in notice["message"]


def test_of_many_photographs_two_that_were_exchanged_are_named():
    views = fitted(PlaneScene.make(np.random.default_rng(5), count=4, turn=0))
    mixed = [replace(view, camera=views[place].camera) for view, place in zip(views, (3, 1, 2, 0), strict=True)]
    assert check_photos(views, DEPTHS) == []
    with pytest.raises(ContradictionError) as caught:
        check_photos(mixed, DEPTHS)
    assert "photograph 0 fits that of 3, 3 fits that of 0; if" in caught.value.cure


@pytest.mark.case("P8")
def test_unrelated_photographs_are_a_warning(plane_scene):
    others = [PlaneScene.make(np.random.default_rng(seed)).images[0] for seed in (1, 2, 3)]
    notices = check_photos(fitted(replace(plane_scene, images=tuple(others))), DEPTHS)
    assert [notice["code"] for notice in notices] in (["photos_hardly_match"], ["poses_doubtful"])


@pytest.mark.case("P8")
def test_plain_cut_outs_are_no_twins(plane_scene):
    """One grey under one mask twice: what the mask leaves out is black, and is no texture."""
    mask = np.zeros((72, 96), bool)
    mask[20:50, 30:70] = True
    plain = np.where(mask, np.float32(0.8), np.float32(0)) * np.ones((3, 1, 1), np.float32)
    views = [replace(view, image=plain, mask=mask) for view in fitted(plane_scene)]
    assert [notice["code"] for notice in check_photos(views, DEPTHS)] == ["no_texture"]


def test_photographs_without_texture_are_a_warning(plane_scene):
    flat = tuple(np.full_like(image, 90) for image in plane_scene.images)
    notices = check_photos(fitted(replace(plane_scene, images=flat)), DEPTHS)
    assert [notice["code"] for notice in notices] == ["no_texture"]


def test_the_score_is_highest_at_the_true_depth(plane_scene):
    coarse = [coarse_view(view) for view in fitted(plane_scene)]
    cameras = [view.camera for view in coarse]
    around = [consistency(coarse, cameras, DepthRange(z, z * 1.0001, "given")) for z in (2.5, 3.3, DEPTH, 5.0, 8.0)]
    assert int(np.argmax(around)) == 2
    assert around[2] > 0.9


def test_warping_at_the_true_depth_reproduces_the_photograph(plane_scene):
    """Camera 0 looks nearly along z and the plane is z = 4; each view sees it at about that depth."""
    views = [coarse_view(view) for view in fitted(plane_scene)]
    straight = np.eye(4)
    camera = views[0].camera.posed(straight)
    warps = [warp_to(v.grey.shape, camera, v, np.array([DEPTH])) for v in views]
    both = warps[0][1][0] & warps[1][1][0]
    assert both.mean() > 0.5
    np.testing.assert_allclose(warps[0][0][0][both], warps[1][0][0][both], atol=0.08)  # bilinear blur; contrast is 0.6
    assert np.corrcoef(warps[0][0][0][both], warps[1][0][0][both])[0, 1] > 0.99


def test_coarse_views_are_block_means_with_their_camera(plane_scene):
    view = fitted(plane_scene, size=(192, 256))[1]
    coarse = coarse_view(view)
    assert coarse.grey.shape == (64, 85)
    assert coarse.grey[3, 4] == pytest.approx(view.image[:, 9:12, 12:15].mean(), abs=1e-6)
    pixels, _ = coarse.camera.project(view.camera.unproject(np.array([[30.0, 60.0]]), np.array([2.0])))
    np.testing.assert_allclose(pixels, [[10.0, 20.0]], atol=1e-12)


def test_window_means_and_correlation_by_brute_force():
    rng = np.random.default_rng(0)
    a, b = rng.random((9, 11)), rng.random((2, 9, 11))
    seen = rng.random((2, 9, 11)) > 0.2
    means = window_mean(a)
    best, weights = np.full((9, 11), -1.0), np.zeros((9, 11))
    for y in range(9):
        for x in range(11):
            window = np.s_[max(0, y - RADIUS) : y + RADIUS + 1, max(0, x - RADIUS) : x + RADIUS + 1]
            assert means[y, x] == pytest.approx(a[window].mean())
            for d in range(2):
                ok = seen[d][window]
                if ok.mean() >= 0.6:
                    weights[y, x] = a[window].std()
                    best[y, x] = max(best[y, x], np.corrcoef(a[window][ok], b[d][window][ok])[0, 1])
    expected = (np.clip(best, 0, 1) * weights).sum() / weights.sum()
    score, total = match_score(a, correlations(a, b, seen).max(axis=0), np.ones((9, 11), bool))
    assert score == pytest.approx(expected, abs=1e-5)
    assert total == pytest.approx(weights.sum(), rel=1e-5)


def test_a_picture_matches_itself_whatever_the_exposure():
    picture = np.random.default_rng(1).random((20, 20))
    every = np.ones((20, 20), bool)
    score, _ = match_score(picture, correlations(picture, 0.3 * picture[None] + 0.2, every[None])[0], every)
    assert score == pytest.approx(1, abs=1e-4)
    unseen = correlations(picture, picture[None], ~every[None])[0]
    assert match_score(picture, unseen, every) == (0.0, 0.0)


@pytest.mark.parametrize("spread", [0.2, 0.02, 0.004, 0.0011])
def test_correlation_depends_on_no_contrast_above_the_rounding_to_8_bits(spread):
    """Dark and hazy photographs are judged as others are: v / (v + 1.28e-6) with itself, whatever else is added."""
    noise = np.random.default_rng(2).normal(size=(24, 24))
    picture = 0.5 + spread * noise
    found = correlations(picture, np.stack([picture, 0.3 + 0.5 * spread * noise]), np.ones((2, 24, 24), bool))
    variance = window_mean(picture**2) - window_mean(picture) ** 2
    rounded = (1 / 255) ** 2 / 12
    np.testing.assert_allclose(found[0], variance / (variance + rounded), atol=1e-9)
    half = 0.5 * variance / np.sqrt((variance + rounded) * (0.25 * variance + rounded))
    np.testing.assert_allclose(found[1], half, atol=1e-9)
    flat = np.full((24, 24), 0.5)
    assert np.abs(correlations(flat, flat[None], np.ones((1, 24, 24), bool))).max() < 1e-6


def test_a_photograph_of_another_scene_among_three_is_named(plane_scene):
    foreign = PlaneScene.make(np.random.default_rng(11)).images[1]
    images = (plane_scene.images[0], foreign, plane_scene.images[2])
    assert check_photos(fitted(plane_scene), DEPTHS) == []
    (notice,) = check_photos(fitted(replace(plane_scene, images=images)), DEPTHS, numbers=(4, 7, 9))
    assert notice["code"] == "view_hardly_matches"
    assert notice["index"] == 7
    assert notice["score"] < 0.68
    assert "view 7 hardly matches any of the others" in notice["message"]
    assert "are its pose and that of view 4, the nearest, right?" in notice["message"]
