"""Confirmed pixels: against a slow reference pixel by pixel, and pixels that must never be confirmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_scene import DEPTH, photograph
from plane_views import SIDE, in_another_world, plane_depths

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.confirmed import AGREEMENT_PX, GOOD_MATCH, PARALLAX_PX, SAME_COLOUR, TEXTURE, confirmed
from gapmes.service.matching.correspondence import parallax, reprojected
from gapmes.service.photographs.images import FittedView, Photo, fit_view


def reference(views: list[FittedView], depths: np.ndarray, index: int, x: int, y: int) -> tuple[bool, float]:
    """One pixel in plain float64 loops, and how far the nearest of all its tests is from its limit."""
    view, found, margin = views[index], False, np.inf
    window = [(j, i) for j in range(y - 3, y + 4) for i in range(x - 3, x + 4) if 0 <= i < SIDE and 0 <= j < SIDE]

    def place(other: FittedView, i: int, j: int, depth: float | None = None) -> tuple[float, float, float]:
        ray = view.camera.rotation @ np.array(
            [(i + 0.5 - view.camera.cx) / view.camera.fx, (j + 0.5 - view.camera.cy) / view.camera.fy, 1.0]
        )
        point = other.camera.rotation.T @ (
            view.camera.center + (depth or depths[index, j, i]) * ray - other.camera.center
        )
        u, v = (other.camera.fx * point[0] / point[2], other.camera.fy * point[1] / point[2])
        return u + other.camera.cx, v + other.camera.cy, point[2]

    def at(values: np.ndarray, u: float, v: float) -> np.ndarray:
        u, v = np.clip(u - 0.5, 0, SIDE - 1), np.clip(v - 0.5, 0, SIDE - 1)
        i, j = int(u), int(v)
        k, n = min(i + 1, SIDE - 1), min(j + 1, SIDE - 1)
        a, b = u - i, v - j
        return (1 - b) * ((1 - a) * values[..., j, i] + a * values[..., j, k]) + b * (
            (1 - a) * values[..., n, i] + a * values[..., n, k]
        )

    mine = np.array([view.image[:, j, i].mean() for j, i in window])
    for other, second in enumerate(views):
        if other == index:
            continue
        places = [place(second, i, j) for j, i in window]
        inside = np.array([0 < u < SIDE and 0 < v < SIDE and z > 0 for u, v, z in places])
        u, v, z = place(second, x, y)
        if not (0 < u < SIDE and 0 < v < SIDE and z > 0) or inside.mean() < 0.6:
            continue
        way = np.linalg.norm(view.camera.center - second.camera.center) * second.camera.fx
        parallax = abs(1 / z - 1 / at(depths[other], u, v)) * way
        colour = np.abs(at(second.image, u, v) - view.image[:, y, x]).mean()
        theirs = np.array([at(second.image, a, b).mean() for a, b, _ in places])[inside]
        ours = mine[inside]
        noise = (1 / 255) ** 2 / 12
        spread = np.sqrt((ours.var() + noise) * (theirs.var() + noise))
        match = np.mean((ours - ours.mean()) * (theirs - theirs.mean())) / spread
        far = place(second, x, y, 1e9)
        moved = np.hypot(u - far[0], v - far[1])
        limits = np.array(
            [
                AGREEMENT_PX - parallax,
                moved - PARALLAX_PX,
                SAME_COLOUR - colour,
                match - GOOD_MATCH,
                np.sqrt(mine.var()) - TEXTURE,
            ]
        )
        found |= bool((limits > 0).all())
        margin = min(margin, np.abs(limits).min())
    return found, margin


def test_it_is_what_the_definition_says(views: list[FittedView]) -> None:
    rng = np.random.default_rng(1)
    depths = plane_depths(views) * (1 + 0.1 * rng.normal(size=(3, SIDE, SIDE)))
    found = confirmed(views, depths)
    checked = 0
    for index, x, y in rng.integers(0, (3, SIDE, SIDE), (300, 3)):
        expected, margin = reference(views, depths, index, x, y)
        if margin > 1e-4:  # of pixels at a limit rounding decides
            assert found[index, y, x] == expected, (index, x, y)
            checked += 1
    assert checked > 280
    assert 0.1 < found.mean() < 0.9


def test_a_surface_that_others_see_is_confirmed(views: list[FittedView]) -> None:
    assert confirmed(views, plane_depths(views)).mean() > 0.75  # found: 0.85; the rest lies outside the other pictures


def test_wrong_depth_is_not(views: list[FittedView]) -> None:
    depths = plane_depths(views)
    way = min(
        np.linalg.norm(a.camera.center - b.camera.center) for a, b in ((views[0], views[1]), (views[1], views[2]))
    )
    step = 1.5 / (way * min(view.camera.fx for view in views))  # half a pixel more than may be
    depths[1] = 1 / (1 / depths[1] + step)
    found = confirmed(views, depths)
    assert not found[1].any()
    assert found[0].any()  # the third view still confirms it


def test_what_shows_nothing_confirms_nothing(views: list[FittedView]) -> None:
    flat = [replace(view, image=np.full_like(view.image, 0.1)) for view in views]
    assert not confirmed(flat, plane_depths(views)).any()


def test_other_colours_do_not_confirm(views: list[FittedView]) -> None:
    brighter = [views[0], replace(views[1], image=views[1].image + np.float32(0.2))]
    assert not confirmed(brighter, plane_depths(views)[:2]).any()


def test_a_twin_from_nearly_the_same_place_confirms_nothing(views: list[FittedView]) -> None:
    """It would agree with any depth."""
    pose = views[0].camera.world_from_cam.copy()
    pose[0, 3] += 1e-6
    twin = replace(views[0], camera=views[0].camera.posed(pose))
    wrong = np.random.default_rng(2).uniform(2.5, 8.0, (SIDE, SIDE))
    depths = plane_depths(views)
    assert confirmed([views[0], twin, views[1]], np.stack([wrong, wrong, depths[1]]))[:2].mean() < 0.05
    assert confirmed([views[0], twin, views[1]], np.stack([depths[0], depths[0], depths[1]]))[:2].mean() > 0.5


def test_ahead_of_a_camera_that_goes_forward_nothing_is_confirmed() -> None:
    """There a point stays where it is in the picture, at whatever depth it lies; around it, it moves."""
    rng = np.random.default_rng(3)
    waves, phases = 4 * rng.normal(size=(3, 8, 2)), rng.uniform(0, 2 * np.pi, size=(3, 8))
    views = []
    for z in (0.0, 1.0):
        pose = np.eye(4)
        pose[2, 3] = z
        camera = Camera.make(SIDE, SIDE, 70.0, 66.0, 30.0, 34.0, pose)
        views.append(fit_view(Photo(photograph(camera, waves, phases)), camera, SIDE, SIDE))
    depths = plane_depths(views)
    moved = parallax(views[0], reprojected(views[0], depths[0], views[1]), views[1])
    column, row = np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5)
    seen = reprojected(views[0], depths[0], views[1]).where
    np.testing.assert_allclose(moved[seen], (np.hypot(column - 30, row - 34) / (DEPTH - 1))[seen], rtol=1e-12)
    found = confirmed(views, depths)[0]
    assert (
        found[seen & (moved > PARALLAX_PX)].mean() > 0.8
    )  # found: 0.89; the rest is next to the border of what is seen
    assert (seen & (moved < PARALLAX_PX)).sum() > 300
    assert not found[moved < PARALLAX_PX].any()


def test_what_is_infinitely_far_behind_the_other_view_moves_infinitely(views: list[FittedView]) -> None:
    pose = views[0].camera.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), np.pi)
    pose[:3, 3] += 2 * DEPTH * views[0].camera.rotation[:, 2]
    facing = replace(views[0], camera=views[0].camera.posed(pose))  # it sees the same points from the other side
    seen = reprojected(views[0], plane_depths(views)[0], facing)
    assert seen.where.sum() > 1000
    assert np.isposinf(parallax(views[0], seen, facing)).all()


def test_masked_pixels_neither_confirm_nor_are_confirmed(views: list[FittedView]) -> None:
    depths, half = plane_depths(views), np.arange(SIDE)[None] < np.full((SIDE, 1), SIDE // 2)
    masked = [replace(views[0], mask=half), *views[1:]]
    whole, some = confirmed(views, depths), confirmed(masked, depths)
    assert not some[0][~half].any()
    assert (some[0] == whole[0])[:, : SIDE // 2 - 3].all()  # where no window crosses the mask's end
    spoiled = replace(masked[0], image=np.where(half, views[0].image, 0.5).astype(np.float32))
    assert (confirmed([spoiled, *views[1:]], depths) == some).all()
    nothing = [views[0], replace(views[1], mask=np.zeros((SIDE, SIDE), bool))]
    assert not confirmed(nothing, depths[:2]).any()


def test_views_that_look_away_confirm_nothing(views: list[FittedView]) -> None:
    pose = views[1].camera.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), np.pi)
    away = replace(views[1], camera=views[1].camera.posed(pose))
    assert not confirmed([views[0], away], plane_depths(views)[:2]).any()


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(unit: float, offset: float, views: list[FittedView]) -> None:
    depths = plane_depths(views)
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    moved = in_another_world(views, turn, shift, unit)
    here, there = confirmed(views, depths), confirmed(moved, unit * depths)
    assert (here != there).mean() < 1e-3  # rounding at a limit
