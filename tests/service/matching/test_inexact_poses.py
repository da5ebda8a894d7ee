"""Photographs match on the epipolar lines of their cameras, and beside them if a pose is inexact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from plane_scene import DEPTH, PlaneScene, photograph
from random_distances import MATCHES, pose_changes
from sample_matches import sample
from wrong_cameras import turned, zoomed

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.captures.capture import load_scene_folder
from gapmes.service.matching.coarse_views import pixel_grid
from gapmes.service.matching.inexact_poses import EpipolarResidual, doubted, epipolar_residuals, inexact_poses
from gapmes.service.matching.pair_matches import PairMatches
from gapmes.service.matching.pose_changes import PoseChanges
from gapmes.service.photographs.images import FittedView, Photo, decode_image, fit_view, match_photo
from gapmes.service.shipped import sample_folder

DEPTHS = DepthRange(2.0, 8.0, "given")
EXACT_PX = 0.15  # measured 0.01 to 0.1, of the sample's photographs


def plane(count: int = 2) -> PairMatches:
    scene = PlaneScene.make(np.random.default_rng(3), count=count, size=(256, 192), turn=0.5)
    return PairMatches(
        [fit_view(Photo(image), c, 192, 256) for image, c in zip(scene.images, scene.cameras, strict=True)], DEPTHS
    )


def told(pairs: PairMatches, numbers: Sequence[int]) -> list[dict]:
    """The warnings about these views."""
    return inexact_poses(pairs, doubted(pairs), numbers)


def of_pair(pairs: PairMatches) -> EpipolarResidual:
    (found,) = epipolar_residuals(pairs)
    return found


@pytest.mark.parametrize("made", [sample, lambda: sample((0, 4)), plane])
def test_exact_poses_stand_on_their_lines(made: Callable[[], PairMatches]) -> None:
    pairs = made()
    assert of_pair(pairs).px < EXACT_PX
    assert told(pairs, (0, 1)) == []


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (1, 0.2, 0.5)])
@pytest.mark.parametrize("made", [sample, plane])
def test_a_turn_is_measured_whichever_camera_has_it(made, axis: Sequence[float], which: int) -> None:
    """Cameras lie beside each other: what is across the lines is up and down, so that these axes show; a turn along
    the lines hardly does, and is found as noise has it."""
    axis = np.asarray(axis) / np.linalg.norm(axis)
    small, large = (of_pair(turned(made(), which, axis, degrees)) for degrees in (0.25, 0.5))
    for found, degrees in ((small, 0.25), (large, 0.5)):
        assert found.turned_px < EXACT_PX
        assert np.degrees(found.turn) == pytest.approx(degrees, rel=0.25)  # measured up to 0.2
    assert large.px == pytest.approx(2 * small.px, rel=0.25)
    assert large.px > 2.5 * EXACT_PX


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("factor", [0.97, 0.98, 1.02, 1.03])
@pytest.mark.parametrize("made", [sample, plane])
def test_a_focal_length_is_measured_whichever_camera_has_it(made, factor: float, which: int) -> None:
    pairs = zoomed(made(), which, factor)
    found = of_pair(pairs)
    assert found.zoomed_px < EXACT_PX
    assert found.turned_px > 2 * found.zoomed_px
    expected = -np.log(factor) if which == 1 else np.log(factor)  # of the second camera, to mend it
    assert found.zoom == pytest.approx(expected, rel=0.25)
    (notice,) = told(pairs, (4, 7))
    one, other = (4, 7) if expected > 0 else (7, 4)
    assert f" % longer, or that of view {one} as much shorter, it would be " in notice["message"]
    assert f"with the focal length of view {other} " in notice["message"]


def test_a_turn_and_a_focal_length_are_told_apart() -> None:
    both = of_pair(zoomed(turned(plane(), 1, (0, 0, 1), 0.5), 1, 1.02))
    assert both.zoomed_px < EXACT_PX < both.turned_px
    assert both.zoom == pytest.approx(-np.log(1.02), rel=0.25)
    alone = of_pair(turned(plane(), 1, (0, 0, 1), 0.5))
    assert abs(alone.zoom) < 0.003


def test_px_are_those_by_which_the_picture_moves() -> None:
    """Up and down by the focal length times the turn, and a little more off the middle."""
    pairs = plane()
    found = of_pair(turned(pairs, 1, (1, 0, 0), 0.3))
    focal = pairs.views[1].camera.fy
    assert focal * np.radians(0.3) < found.px < 1.2 * focal * np.radians(0.3)


def test_it_is_told_with_the_views_and_the_turn() -> None:
    (notice,) = told(turned(sample(), 1, (1, 0, 0), 0.5), (4, 7))
    assert notice["code"] == "poses_inexact"
    assert "what views 4 and 7 have in common stands " in notice["message"]
    assert notice["px"] > 0.5
    assert "turned by 0." in notice["message"]
    assert notice["message"].endswith("for example with COLMAP, or set refine_poses)")


def test_where_refining_was_tried_its_limits_are_told() -> None:
    pairs = turned(sample(), 1, (1, 0, 0), 0.5)
    (notice,) = inexact_poses(pairs, doubted(pairs), (4, 7), tried=True)
    assert "as refine_poses could not altogether: it corrects up to 3 degrees, 10% of a focal" in notice["message"]
    assert "0.2 of the longest baseline, where less than 50% of the error is left" in notice["message"]


def test_of_three_views_the_worst_pair_is_named_first() -> None:
    pairs = turned(sample((1, 3, 5)), 2, (1, 0, 0), 0.6)
    (notice,) = told(pairs, (4, 7, 9))
    assert "what views 7 and 9 have in common" in notice["message"]
    assert "the same of" not in notice["message"]
    (notice,) = told(turned(sample((1, 3, 5)), 1, (1, 0, 0), 0.6), (4, 7, 9))
    assert "; the same of views " in notice["message"]


@pytest.mark.parametrize("wrong", range(3))
def test_of_three_views_the_one_that_is_wrong_is_named(wrong: int) -> None:
    (notice,) = told(turned(sample((1, 3, 5)), wrong, (1, 0, 0), 0.6), (4, 7, 9))
    named = f"; changes of the camera of view {(4, 7, 9)[wrong]} alone explain it as well as those of all but one do"
    assert named in notice["message"]
    assert "the same of" not in notice["message"].partition(named)[0]  # it is that of the worst pair


def test_where_several_are_wrong_or_either_of_two_none_is_named() -> None:
    """Of three views the outer ones are turned, about different axes."""
    outer = turned(turned(sample((1, 3, 5)), 0, (1, 0, 0), 0.6), 2, (0, 0, 1), 0.8)
    for pairs in (outer, turned(sample(), 1, (1, 0, 0), 0.6)):
        (notice,) = told(pairs, (4, 7, 9))
        assert "alone explain" not in notice["message"]


def test_a_view_whose_change_explains_less_than_half_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances that no camera explains, and some that one does: of the worst pair most is left."""
    found, _ = pose_changes(3, (1,), noise=1.2, change=2e-3)
    median = float(np.median(np.abs(found.px[:MATCHES])))
    assert found.culprit(0) == 1
    assert found.left_px((0, 1), 1) > 0.5 * median
    residual = EpipolarResidual((0, 1), median, median, 0.0, median, 0.0)
    monkeypatch.setattr(PoseChanges, "of", lambda _pairs: found)
    (notice,) = inexact_poses(sample((1, 3, 5)), [residual], (4, 7, 9))
    assert "no turn and no focal length of one of them explains half of it (" in notice["message"]


def test_halves_of_a_row_that_stand_askew_are_told() -> None:
    """As after a tracker's slip: in a row of four, the last two are right among themselves, and nearest to each other,
    as are the first two."""
    exact = sample((0, 2, 5, 7))
    assert exact.nearest() == [(0, 1), (2, 3)]
    assert told(exact, (0, 2, 5, 7)) == []
    views, middle = list(exact.views), np.mean([view.camera.center for view in exact.views[2:]], axis=0)
    turn = about_axis(np.array([1.0, 0.0, 0.0]), np.radians(0.7))
    for which in (2, 3):
        pose = views[which].camera.world_from_cam.copy()
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], middle + turn @ (pose[:3, 3] - middle)
        views[which] = replace(views[which], camera=views[which].camera.posed(pose))
    (notice,) = told(PairMatches(views, exact.depths), (0, 2, 5, 7))
    assert "what views 2 and 5 have in common" in notice["message"]
    assert "the same of" not in notice["message"]


def test_larger_pictures_may_be_off_by_more() -> None:
    """As they are aligned where coarse matches are, whose cells grow with them."""
    small = turned(sample(), 1, (1, 0, 0), 0.15)
    cameras = [view.camera for view in small.views]
    scene = load_scene_folder(sample_folder())
    photos = [decode_image(scene.image_paths[i].read_bytes(), index=i) for i in (1, 3)]
    views = [
        fit_view(*match_photo(photo, scene.file.views[i].camera), 512, 512)
        for i, photo in zip((1, 3), photos, strict=True)
    ]
    views = [replace(v, camera=v.camera.posed(c.world_from_cam)) for v, c in zip(views, cameras, strict=True)]
    large = PairMatches(views, small.depths)
    assert of_pair(large).px > 1.5 * of_pair(small).px
    (of_small,), (of_large,) = told(small, (0, 1)), told(large, (0, 1))
    assert "usual is 0.1 to 0.5" in of_small["message"]
    assert "usual is 0.2 to 1.0" in of_large["message"]


def test_exposure_has_no_say() -> None:
    pairs = turned(sample(), 1, (1, 0, 0), 0.4)
    dark = replace(pairs.views[0], image=pairs.views[0].image * np.float32(0.5) + np.float32(0.1))
    found = of_pair(PairMatches([dark, pairs.views[1]], pairs.depths))
    assert found.px == pytest.approx(of_pair(pairs).px, abs=0.05)


def test_what_masks_leave_out_has_no_say() -> None:
    pairs = sample()
    mask = np.ones((256, 256), np.bool_)
    mask[:, 120:] = False
    found = set()
    for fill in (0.0, 1.0, 0.5):
        views = [replace(view, image=np.where(mask, view.image, np.float32(fill)), mask=mask) for view in pairs.views]
        found.add(of_pair(PairMatches(views, pairs.depths)))
    px = {beside.px for beside in found}
    assert max(px) - min(px) < 1e-12
    assert max(px) < EXACT_PX


def before_a_wall(size: int = 128) -> PairMatches:
    """A dark disc at half the depth of a wall of slanting stripes, both with a little texture. A camera that sees the
    disc from twice as far to the side sees the same of one of twice the size at the wall."""
    generator = np.random.default_rng(8)
    waves, phases = generator.normal(size=(2, 3, 24, 2)) * 8, generator.uniform(0, 2 * np.pi, size=(2, 3, 24))
    across, down = pixel_grid((size, size)).T.reshape(2, size, size)
    views = []
    for way in (0.0, 0.4):
        camera = Camera.make(size, size, size, size, size / 2, size / 2, np.eye(4))
        behind, before = np.eye(4), np.eye(4)
        behind[0, 3], before[0, 3] = way, 2 * way
        wall, disc = (
            0.15 * photograph(camera.posed(pose), waves[k], phases[k]) for k, pose in enumerate((behind, before))
        )
        x, y = (across / size - 0.5) * DEPTH, (down / size - 0.5) * DEPTH
        wall += 100 + 60 * np.tanh(4 * np.sin(5 * (x + way) + 5 * y))[..., None]
        seen = np.where((np.hypot(x + 2 * way - 0.7, y) < 1.2)[..., None], disc, wall)
        views.append(fit_view(Photo(np.rint(seen).astype(np.uint8)), camera.posed(behind), size, size))
    return PairMatches(views, DepthRange(1.0, 8.0, "given"))


def test_silhouettes_are_not_looked_at() -> None:
    """Where an edge behind a thing meets its own, they meet elsewhere from another place, beside the line."""
    assert of_pair(before_a_wall()).px < EXACT_PX


def test_what_does_not_match_is_not_judged() -> None:
    pairs = sample()
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in pairs.views]
    noise = [replace(v, image=np.random.default_rng(i).random(v.image.shape, np.float32)) for i, v in enumerate(flat)]
    views: list[FittedView]
    for views in (flat, noise):
        assert epipolar_residuals(PairMatches(views, pairs.depths)) == []
