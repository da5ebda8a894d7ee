"""Matching where symmetric cameras, full masks and small shifts would hide what is mistaken for what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sample_matches import sample
from sample_photographs import sample_views
from wrong_cameras import turned

from gapmes.service.cameras.camera import Camera, pixel_grid
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching import epipolar, given_range
from gapmes.service.matching.coarse_views import CoarseView, warp_to
from gapmes.service.matching.correspondence import pixels_per_inverse_depth
from gapmes.service.matching.depth_sweep import AGREEMENT_PX, Matches, _leads_back
from gapmes.service.matching.duplicates import _made_by_motion, least_motion_px
from gapmes.service.matching.exposures import exposures
from gapmes.service.matching.inexact_poses import EpipolarResidual, doubted
from gapmes.service.matching.pair_matches import PairMatches
from gapmes.service.matching.plane_sweep import swept_px
from gapmes.service.matching.refined_poses import refined_cameras
from gapmes.service.photographs.images import FittedView

UP = np.array([0.0, 1.0, 0.0])


def posed(center: tuple[float, ...], turn: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = about_axis(UP, turn), center
    return pose


def test_the_swept_disparity_is_that_of_the_corner_that_moves_most() -> None:
    """By differences of projections far away; the principal point is in a corner, and one camera stands ahead."""
    one = Camera.make(64, 48, 60.0, 70.0, 10.0, 40.0, posed((0, 0, 0)))
    other = one.posed(posed((0.1, 0.05, -0.3)))
    corners, step, most = np.array([[x, y] for x in (0.0, 64.0) for y in (0.0, 48.0)]), 1e-6, 0.0
    for camera, neighbour in ((one, other), (other, one)):
        there, _ = neighbour.project(camera.unproject(corners, np.full(4, 1 / step)))
        most = max(most, np.linalg.norm(there - corners, axis=1).max() / step)
    assert swept_px([one, other], DepthRange(2.0, 5.0, "given")) == pytest.approx(most * (1 / 2 - 1 / 5), rel=1e-4)


def test_disparity_counts_what_lies_along_the_axis_by_the_mean_focal_length() -> None:
    def view(pose: np.ndarray) -> FittedView:
        camera = Camera.make(32, 32, 60.0, 90.0, 16.0, 16.0, pose)
        return FittedView(np.zeros((3, 32, 32), np.float32), None, camera, 1.0)

    found = pixels_per_inverse_depth(view(posed((0.1, 0.2, 0.3))), view(posed((0, 0, 0))))
    assert found == pytest.approx(np.sqrt((60 * 0.1) ** 2 + (90 * 0.2) ** 2 + 60 * 90 * 0.3**2))


@pytest.mark.parametrize(("off", "leads"), [(-0.9, True), (0.9, True), (-1.1, False), (1.1, False)])
def test_a_match_leads_back_from_the_middle_of_its_cell(off: float, leads: bool) -> None:
    """By up to AGREEMENT_PX to either side: four pixels of disparity there, `off` times that more on the way back."""
    camera = Camera.make(32, 24, 40.0, 40.0, 16.0, 12.0, posed((0, 0, 0)))
    kept = np.ones((24, 32), np.bool_)
    one = CoarseView(np.zeros((24, 32)), kept, camera)
    other = CoarseView(np.zeros((24, 32)), kept, camera.posed(posed((0.5, 0, 0))))
    depth = np.full((24, 32), 40 * 0.5 / 4)
    back = np.full((24, 32), 40 * 0.5 / (4 + off * AGREEMENT_PX))
    found = _leads_back(one, depth, other, back).reshape(24, 32)
    assert (found[:, 8:] == leads).all()
    assert not found[:, :4].any()  # beside the other picture


def test_what_slides_out_of_the_picture_is_no_match() -> None:
    """A window whose aligned place is beyond the left border, where samples repeat the border's."""
    x, y = (axis.reshape(40, 40) for axis in pixel_grid((40, 40)).T)
    grey = 0.5 + 0.2 * np.sin(0.5 * x + 0.3) * np.cos(0.4 * y) + 0.1 * np.sin(0.23 * x - 0.31 * y)
    camera = Camera.make(40, 40, 40.0, 40.0, 20.0, 20.0, np.eye(4))
    picture = epipolar._picture(FittedView(np.repeat(grey[None].astype(np.float32), 3, axis=0), None, camera, 1.0))
    offsets = pixel_grid((2 * epipolar.RADIUS + 1,) * 2) - (epipolar.RADIUS + 0.5)
    middles = np.array([[epipolar.RADIUS + 0.6, 20.0], [20.0, 20.0]])
    there = middles[:, None] + offsets
    shift, good = epipolar._alignment(epipolar._sampled(picture, there - np.array([0.8, 0.0])), picture, there)
    np.testing.assert_allclose(shift, [[-0.8, 0.0]] * 2, atol=0.1)
    assert list(good) == [False, True]


def test_cameras_in_one_place_have_no_distances_from_lines() -> None:
    """Everything matches, and nothing tells how far from a line that there is not."""
    (view, _) = sample_views((1, 5))
    coarse = (32, 32)
    match = Matches(1, np.full(coarse, 4.0), np.ones(coarse), np.ones(32 * 32, np.bool_), np.ones(coarse))
    for shift, some in ((0.0, False), (0.05, True)):
        pose = view.camera.world_from_cam.copy()
        pose[:3, 3] += shift * pose[:3, 1]
        views = [view, replace(view, camera=view.camera.posed(pose))]
        px, slopes = epipolar._distances(0, match, views, [epipolar._picture(each) for each in views], 1.0)
        assert (len(px) > 0) == some
        assert len(px) == len(slopes)


def test_hidden_pixels_do_not_tell_what_a_motion_makes() -> None:
    (view,) = sample_views((1, 5))[:1]
    kept = np.ones(view.image.shape[1:], np.bool_)
    kept[:, 100:] = kept[100:] = False
    rng, found = np.random.default_rng(0), []
    for fill in (np.zeros(view.image.shape), rng.random(view.image.shape)):
        image = np.where(kept, view.image, fill).astype(np.float32)
        found.append(_made_by_motion(replace(view, image=image, mask=kept)))
    assert found[0] == found[1] > 0


def test_what_lies_behind_the_other_camera_does_not_move() -> None:
    camera = Camera.make(32, 24, 40.0, 40.0, 16.0, 12.0, posed((0, 0, 0)))
    assert least_motion_px(camera, camera.posed(posed((0, 0, 0), np.pi)), DepthRange(1.0, 5.0, "given")) == np.inf


def test_a_warped_pixel_is_seen_where_both_columns_under_it_are_kept() -> None:
    """The other camera stands half a pixel to the side, and its column 4 is masked."""
    kept = np.ones((6, 8), np.bool_)
    kept[:, 4] = False
    camera = Camera.make(8, 6, 8.0, 8.0, 4.0, 3.0, np.eye(4))
    view = CoarseView(np.random.default_rng(0).random((6, 8)), kept, camera)
    _, seen = warp_to((6, 8), camera.posed(posed((0.5 / 8, 0, 0))), view, np.array([1.0]))
    assert seen[0, 0].astype(int).tolist() == [1, 1, 1, 0, 0, 1, 1, 0]


def test_both_ends_of_a_range_are_more_than_one_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that matches lies on the second plane from either end."""
    rng, swept = np.random.default_rng(0), np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    depth = np.full((6, 8), 2.0)
    depth[:, 4:] = 4.0
    monkeypatch.setattr(given_range, "best_planes", lambda *_: (np.full((6, 8), 0.9), depth))
    camera = Camera.make(8, 6, 8.0, 8.0, 4.0, 3.0, np.eye(4))
    views = [
        CoarseView(rng.random((6, 8)), np.ones((6, 8), np.bool_), camera.posed(posed((x, 0, 0)))) for x in (0.0, 1.0)
    ]
    near, far = given_range._at_ends(views, swept)
    assert near == pytest.approx(0.5, abs=0.05)
    assert near + far == pytest.approx(1.0)


def test_gains_do_not_depend_on_which_view_comes_first() -> None:
    """The second view, of three, joins the others last."""
    pairs, factors = sample((5, 1, 3)), np.array([0.7, 1.0, 0.85])
    views = [
        replace(view, image=(view.image * factor).astype(np.float32))
        for view, factor in zip(pairs.views, factors, strict=True)
    ]
    found = exposures(PairMatches(views, pairs.depths))
    assert found is not None
    np.testing.assert_allclose(found.gains, np.repeat((0.85 / factors)[:, None], 3, axis=1), atol=0.01)


def test_cameras_are_not_refined_where_a_doubted_pair_is_no_longer_measured() -> None:
    pairs = turned(sample((1, 3, 5)), 1, (1.0, 0.0, 0.0), 0.7)
    before = doubted(pairs)
    assert refined_cameras(pairs, before, (0, 1, 2)) is not None
    lost = EpipolarResidual((0, 2), max(one.px for one in before), 0.1, 0.01, 0.1, 0.0)
    assert (0, 2) not in pairs.joined()
    assert refined_cameras(pairs, [*before, lost], (0, 1, 2)) is None
