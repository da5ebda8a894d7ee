"""Cut-out photographs: no sheet of the backdrop is seen in what their masks leave out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gapmes.export.evaluation.case import Case, generated_cases
from gapmes.service.cameras.camera import Camera, pixel_grid
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.mending.backdrop import backdrop
from gapmes.service.mending.outlines import REACH, clear_of_masks, kept_around
from gapmes.service.photographs.images import FittedView, Photo, fit_view
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import render

SIDE, AWAY, RADIUS = 128, 4.0, 1.0


def around(degrees: float) -> Camera:
    """A camera on a circle about the origin that looks at it."""
    pose = np.eye(4)
    pose[:3, :3] = about_axis(np.array([0.0, 1.0, 0.0]), np.radians(degrees))
    pose[:3, 3] = pose[:3, :3] @ [0.0, 0.0, -AWAY]
    return Camera.make(SIDE, SIDE, 140.0, 140.0, SIDE / 2, SIDE / 2, pose)


def ball(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) z-depths of a ball at the origin before a wall far behind, and where the ball is."""
    rays = camera.rays(pixel_grid((SIDE, SIDE)))  # of z-depth 1
    a, b = (rays**2).sum(axis=1), rays @ camera.center
    inside = b**2 - a * (AWAY**2 - RADIUS**2)
    near = (-b - np.sqrt(np.maximum(inside, 0))) / a
    return np.where(inside > 0, near, 3 * AWAY).reshape(SIDE, SIDE), (inside > 0).reshape(SIDE, SIDE)


def views_of(angles: Sequence[float]) -> tuple[list[FittedView], np.ndarray]:
    """Photographs of the ball, cut out, and their depths."""
    views, depths = [], []
    for seed, degrees in enumerate(angles):
        camera = around(degrees)
        depth, there = ball(camera)
        rgb = np.random.default_rng(seed).integers(60, 200, (SIDE, SIDE, 3), dtype=np.uint8)
        views.append(fit_view(Photo(rgb, there), camera, SIDE, SIDE))
        depths.append(depth)
    return views, np.stack(depths)


def test_the_share_that_is_kept_is_counted() -> None:
    kept = np.random.default_rng(0).random((9, 13)) < 0.5
    for reach in (0, 1, 4, 20):
        found = kept_around(kept, reach)
        for row in range(9):
            for column in range(13):
                window = kept[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
                assert found[row, column] == pytest.approx(window.mean())


@pytest.mark.parametrize("angles", [(-8.0, 8.0), (-12.0, 0.0, 12.0)])
def test_the_sheet_of_a_cut_out_ball_stays_within_its_outline(angles: tuple[float, ...]) -> None:
    """From the inputs, from between them and from beside them. Largest mean 0.0008, largest opacity 0.15; the whole
    sheet has 0.04 and 0.92."""
    views, depths = views_of(angles)
    sheet, around_it = backdrop(views, depths, 1)
    assert around_it == len(sheet) > 20  # the inner part of the ball is still backed
    for degrees in (*angles, 0.0, 4.0, 15.0):
        camera = around(degrees)
        drawn = render(sheet, camera).alpha
        _, there = ball(camera)
        outside = kept_around(there, 3) == 0
        assert drawn[outside].mean() < 0.01
        assert drawn[outside].max() < 0.2
        assert drawn[kept_around(there, 20) == 1].min() > 0.8


@pytest.mark.parametrize("width", [4, 8, 16, 17, 32])
def test_a_sheet_may_stand_behind_a_masked_passer_by(width: int) -> None:
    """Who hides what the other view shows: only the sheet of his own view keeps away from him."""
    views, depths = views_of((-4.0, 4.0))
    depths[:] = AWAY
    there = np.ones((SIDE, SIDE), np.bool_)
    there[32:96, 64 - width // 2 : 64 + width // 2] = False
    hidden = [replace(views[0], mask=there), replace(views[1], mask=None)]
    points = np.stack([np.linspace(-0.5, 0.5, 41), np.zeros(41), np.zeros(41)], axis=1)
    own, other = (clear_of_masks(points, np.full(41, owner), hidden, depths) for owner in (0, 1))
    pixels = (views[0].camera.project(points)[0] - 0.25).astype(np.intp)
    near = kept_around(there, REACH)[pixels[:, 1], pixels[:, 0]] < 0.95
    np.testing.assert_array_equal(own, ~near)
    assert near.any()
    assert other.all()
    if width < 20:  # narrower than an outline can be told from
        return
    outlined = [replace(views[0], mask=there), replace(views[1], mask=seen_from(views[1], hidden[0]))]
    both = clear_of_masks(points, np.full(41, 1), outlined, depths)
    assert not both[near].any()  # where neither shows anything, it is an outline


@pytest.mark.parametrize("bar", [4, 9, 24])
def test_bars_change_nothing(bar: int) -> None:
    """A letterboxed film has them in every frame, a screenshot at one side."""
    views, depths = views_of((-4.0, 4.0))
    depths[:] = AWAY
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 3)) * [1, 1, 0]
    for kept in (np.s_[bar:-bar], np.s_[:, bar:]):
        there = np.zeros((SIDE, SIDE), np.bool_)
        there[kept] = True
        for masks in ((there, there), (there, None)):
            barred = [replace(view, mask=mask) for view, mask in zip(views, masks, strict=True)]
            for owner in (0, 1):
                assert clear_of_masks(points, np.full(200, owner), barred, depths).all()


def test_units_do_not_change_what_is_clear() -> None:
    """Centres of cells project to where pixels meet."""
    views, depths = views_of((-8.0, 8.0))
    counts = set()
    for unit in (1.0, 3.0, 7.0, 0.1, 1e5):
        scaled = []
        for view in views:
            pose = view.camera.world_from_cam.copy()
            pose[:3, 3] *= unit
            scaled.append(replace(view, camera=view.camera.posed(pose)))
        counts.add(len(backdrop(scaled, unit * depths, 1)[0]))
    assert len(counts) == 1


def seen_from(view: FittedView, other: FittedView) -> np.ndarray:
    """(H, W) the pixels of `view` whose points on a wall at the origin the mask of `other` keeps."""
    points = view.camera.unproject(pixel_grid((SIDE, SIDE)), np.full(SIDE * SIDE, AWAY))
    pixels, z = other.camera.project(points)
    inside = other.camera.shows(pixels, z)
    column, row = np.where(inside[:, None], pixels, 0).astype(np.intp).T
    return (inside & other.kept[row, column]).reshape(SIDE, SIDE)


def cut_out(case: Case, share: float) -> tuple[list[Photo], list[np.ndarray]]:
    """The inputs without what lies outside of a ball about the middle of the first, which has `share` of its pixels,
    and the outlines of the targets."""
    assert case.truth is not None

    def points(camera: Camera, depth: np.ndarray) -> np.ndarray:
        return camera.unproject(pixel_grid(depth.shape), depth.ravel().astype(np.float64)).reshape(*depth.shape, 3)

    surfaces = case.truth.input_surfaces()
    first = points(case.inputs[0].camera, surfaces[0])
    quarter = len(first) * 3 // 8
    centre = np.median(first[quarter:-quarter, quarter:-quarter].reshape(-1, 3), axis=0)
    radius = np.quantile(np.linalg.norm(first - centre, axis=2), share)

    def kept(camera: Camera, depth: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points(camera, depth) - centre, axis=2) <= radius

    masks = [kept(view.camera, depth) for view, depth in zip(case.inputs, surfaces, strict=True)]
    photos = [
        Photo(np.where(m[..., None], p.rgb, 0).astype(np.uint8), m) for p, m in zip(case.photos, masks, strict=True)
    ]
    far = np.minimum(case.truth.targets, np.float32(case.truth.far))
    return photos, [kept(view.camera, depth) for view, depth in zip(case.targets, far, strict=True)]


def test_a_cut_out_scene_shows_little_beside_its_outline() -> None:
    """With the packaged network. Mean opacity from 3 px beside the true outlines on: 0.022, and 0.156 with the whole
    sheet. Within the outlines, from 5 px on, it is 0.993 and 0.999."""
    (case,) = generated_cases(1, 2, 256, 256, seed=31_337)
    photos, outlines = cut_out(case, 0.35)
    more = {"near": case.near, "far": case.far, "trust_poses": True, "leave_one_out": 0}
    scene = Reconstructor().reconstruct(photos, list(case.cameras), **more)
    beside, within = [], []
    for target, outline in zip(case.targets, outlines, strict=True):
        alpha = scene.render(target.camera).alpha
        beside.append(alpha[kept_around(outline, 2) == 0].mean())
        within.append(alpha[kept_around(outline, 4) == 1].mean())
    assert np.mean(beside) < 0.06
    assert np.mean(within) > 0.9


def test_a_mask_says_nothing_of_what_its_view_does_not_show() -> None:
    views, depths = views_of((-8.0, 8.0))
    away = np.array([[9.0, 0.0, 0.0], [-9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, -9.0]])
    for owner in (0, 1):
        assert clear_of_masks(away, np.full(4, owner), views, depths).all()


def test_what_others_have_beside_a_mask_lies_at_their_own_depths() -> None:
    """Those of the view whose mask is judged do not matter."""
    views, depths = views_of((-4.0, 4.0))
    there = np.ones((SIDE, SIDE), np.bool_)
    there[32:96, 48:80] = False
    hidden = [replace(views[0], mask=there), replace(views[1], mask=None)]
    depths[0], depths[1] = 0.01, AWAY
    points = np.stack([np.linspace(-0.5, 0.5, 41), np.zeros(41), np.zeros(41)], axis=1)
    assert clear_of_masks(points, np.full(41, 1), hidden, depths).all()


@pytest.mark.parametrize("focal", [140.0, 100.0])
@pytest.mark.parametrize(("twentieths", "outline"), [(3, True), (6, False)])
def test_a_mask_is_no_outline_where_others_show_more_than_a_quarter_of_what_it_leaves_out(
    focal: float, twentieths: int, outline: bool
) -> None:
    """Of what falls into its picture; a wider view shows more besides."""
    (first, second), depths = views_of((-4.0, 4.0))
    there = np.ones((SIDE, SIDE), np.bool_)
    there[32:96, 32:96] = False
    hidden = replace(first, mask=there)
    camera = Camera.make(SIDE, SIDE, focal, focal, SIDE / 2, SIDE / 2, second.camera.world_from_cam)
    depths[:] = AWAY
    other = replace(second, camera=camera, mask=None)
    row, column = np.mgrid[:SIDE, :SIDE] // 4
    points = camera.unproject(pixel_grid((SIDE, SIDE)), np.full(SIDE**2, AWAY))
    x, y = first.camera.project(points)[0].T.reshape(2, SIDE, SIDE)
    left_out = (abs(x - 64) < 32) & (abs(y - 64) < 32)
    other = replace(other, mask=~left_out | ((7 * row + 3 * column) % 20 < twentieths))
    points = np.stack([np.linspace(-0.5, 0.5, 41), np.zeros(41), np.zeros(41)], axis=1)
    clear = clear_of_masks(points, np.full(41, 2), [hidden, other], depths)  # of a further view
    assert clear.any() != outline
