"""Refined depths: closer to the truth where photographs determine them, and unchanged where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import SIDE, in_another_world, plane_depths

from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.correspondence import disagreement, pixels_per_inverse_depth, reprojected
from gapmes.service.matching.match_cost import GAIN, NOTHING
from gapmes.service.mending.refined import OFFSETS_PX, RANGE, _least, refined
from gapmes.service.photographs.images import FittedView


def off_by(views: list[FittedView], depths: np.ndarray, pixels: np.ndarray | float) -> np.ndarray:
    """Depths whose error is `pixels` of parallax in the view farthest away."""
    most = [max(pixels_per_inverse_depth(a, b) for b in views if b is not a) for a in views]
    return 1 / (1 / depths + pixels / np.array(most)[:, None, None])


def errors(views: list[FittedView], depths: np.ndarray) -> np.ndarray:
    """(V, H, W) of the inverse depth, in px of parallax in the view farthest away."""
    most = [max(pixels_per_inverse_depth(a, b) for b in views if b is not a) for a in views]
    return np.abs(1 / depths - 1 / plane_depths(views)) * np.array(most)[:, None, None]


@pytest.mark.parametrize("pixels", [-0.9, -0.4, 0.4, 0.9])
def test_a_surface_comes_back(pixels: float, views: list[FittedView]) -> None:
    found = errors(views, refined(views, off_by(views, plane_depths(views), pixels)))
    assert np.median(found) < 0.2 * abs(pixels)  # found: 0.08 to 0.11 of it


def test_what_is_right_stays(views: list[FittedView]) -> None:
    depths = plane_depths(views)
    found = refined(views, depths)
    assert (found == depths).mean() > 0.999  # found: 0.99976


def test_waves_of_depth_are_lowered(views: list[FittedView]) -> None:
    """What errs from pixel to pixel stays: a window has one offset."""
    wave = 0.8 * np.sin(np.arange(SIDE) / 5.0) * np.ones((3, SIDE, SIDE))
    rough = off_by(views, plane_depths(views), wave)
    assert errors(views, refined(views, rough)).mean() < 0.4 * errors(views, rough).mean()  # found: 0.33


def test_nothing_to_compare_leaves_the_bits(views: list[FittedView]) -> None:
    depths = off_by(views, plane_depths(views), 0.7)
    flat = [replace(view, image=np.full_like(view.image, 0.4)) for view in views]
    assert (refined(flat, depths) == depths).all()
    masked = [replace(view, mask=np.zeros((SIDE, SIDE), bool)) for view in views]
    assert (refined(masked, depths) == depths).all()
    pose = views[1].camera.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ about_axis(np.array([0.0, 1.0, 0.0]), np.pi)
    away = [views[0], replace(views[1], camera=views[1].camera.posed(pose))]
    assert (refined(away, depths[:2]) == depths[:2]).all()
    same_place = [views[0], views[0]]
    assert (refined(same_place, depths[[0, 0]]) == depths[[0, 0]]).all()


def test_masked_pixels_stay_and_are_not_looked_at(views: list[FittedView]) -> None:
    depths, half = off_by(views, plane_depths(views), 0.7), np.arange(SIDE)[None] < np.full((SIDE, 1), SIDE // 2)
    found = refined([replace(views[0], mask=half), *views[1:]], depths)
    assert (found[0] == depths[0])[~half].all()
    assert (found[0] != depths[0])[half].any()
    other = replace(views[1], mask=half)  # what its mask hides may be anything
    spoiled = replace(other, image=np.where(half, other.image, 0.5).astype(np.float32))
    here, there = refined([views[0], other], depths[:2])[0], refined([views[0], spoiled], depths[:2])[0]
    assert (here == there).all()
    assert (here != depths[0]).mean() > 0.3


def test_it_moves_by_a_pixel_at_most_and_never_far(views: list[FittedView]) -> None:
    """Cameras next to each other: a pixel of parallax would be all there is between near and far."""
    depths = plane_depths(views) * np.random.default_rng(3).uniform(0.7, 1.4, (3, SIDE, SIDE))
    found = refined(views, depths)
    most = [max(pixels_per_inverse_depth(a, b) for b in views if b is not a) for a in views]
    moved = np.abs(1 / found - 1 / depths) * np.array(most)[:, None, None]
    assert moved.max() <= OFFSETS_PX[-1] * (1 + 1e-9)
    close = []
    for number, view in enumerate(views):
        pose = views[0].camera.world_from_cam.copy()
        pose[:3, 3] += 1e-3 * number
        close.append(replace(view, camera=views[0].camera.posed(pose)))
    ratio = refined(close, depths) / depths
    assert ratio.min() >= 1 / RANGE - 1e-12
    assert ratio.max() <= RANGE + 1e-12


def test_a_pixel_is_one_of_the_other_view(views: list[FittedView]) -> None:
    """Of another lens, here one of 3/4 the focal length: the largest step is a pixel there."""
    camera = views[1].camera
    wide = replace(views[1], camera=replace(camera, fx=0.75 * camera.fx, fy=0.75 * camera.fy))
    depths = plane_depths(views)[:2] * np.random.default_rng(3).uniform(0.9, 1.1, (2, SIDE, SIDE))
    found = refined([views[0], wide], depths)
    moved = np.abs(1 / found[0] - 1 / depths[0]).max() * pixels_per_inverse_depth(views[0], wide)
    assert moved == pytest.approx(OFFSETS_PX[-1])


@pytest.mark.parametrize("way", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.2, -0.1, 0.0)])
def test_pixels_that_are_not_square_are_measured_each_way(
    way: tuple[float, float, float], views: list[FittedView]
) -> None:
    """The place where a point on the axis is seen moves by so much per unit of 1/z."""
    here = views[0].camera.posed(np.eye(4))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = about_axis(np.array([0.0, 0.0, 1.0]), 0.7), way
    there = replace(here, fx=250.0, fy=80.0).posed(pose)
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 5.0]])
    (one, other), _ = there.project(points)
    measured = pixels_per_inverse_depth(replace(views[0], camera=here), replace(views[0], camera=there))
    assert measured == pytest.approx(np.linalg.norm(one - other) / (1 / 2 - 1 / 5))


def test_pixels_that_are_square_have_the_same_measure_however_the_camera_is_turned(views: list[FittedView]) -> None:
    """To the bit; a way forward counts as if it lay across, by the mean focal length where there are two."""
    here, rng = views[0].camera, np.random.default_rng(1)
    for _ in range(20):
        pose = np.eye(4)
        pose[:3, :3] = about_axis(np.array([0.48, -0.6, 0.64]), rng.uniform(0, 3))
        pose[:3, 3] = here.center + rng.normal(size=3)
        there = replace(here, fx=77.7, fy=77.7).posed(pose)
        measured = pixels_per_inverse_depth(views[0], replace(views[0], camera=there))
        assert measured == 77.7 * float(np.linalg.norm(here.center - there.center))
    pose = here.world_from_cam.copy()
    pose[:3, 3] += 0.5 * pose[:3, 2]
    ahead = replace(views[0], camera=replace(here, fx=250.0, fy=90.0).posed(pose))
    assert pixels_per_inverse_depth(views[0], ahead) == pytest.approx(0.5 * 150.0)
    assert pixels_per_inverse_depth(ahead, ahead) == 0


def test_a_twin_from_the_same_place_changes_nothing(views: list[FittedView]) -> None:
    depths = off_by(views, plane_depths(views), 0.7)
    with_twin = refined([views[0], views[1], views[0]], depths[[0, 1, 0]])
    assert (with_twin[0] == refined(views[:2], depths[:2])[0]).all()


@pytest.mark.parametrize(("unit", "offset"), [(1e-3, 0.0), (300.0, -5e4)])
def test_the_world_and_its_unit_do_not_matter(unit: float, offset: float, views: list[FittedView]) -> None:
    depths = off_by(views, plane_depths(views), 0.7)
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([offset, -offset, 0.5 * offset])
    moved = in_another_world(views, turn, shift, unit)
    here, there = refined(views, depths), refined(moved, unit * depths) / unit
    assert (np.abs(here / there - 1) > 1e-6).mean() < 1e-3  # rounding at a tie


def test_the_least_cost_lies_between_the_steps() -> None:
    """Parabolas whose vertices are known."""
    vertices = np.random.default_rng(4).uniform(-0.7, 0.7, (8, 8))
    costs = 1 + 4 * (np.array(OFFSETS_PX)[:, None, None] - vertices) ** 2
    offset, gains = _least(costs)
    assert np.abs(offset - vertices).max() < 1e-9
    at_best = costs.min(axis=0)
    assert (gains == (at_best < GAIN * costs[2] - NOTHING)).all()
    edge = np.broadcast_to(np.array(OFFSETS_PX)[:, None, None], (5, 2, 2))  # falls towards the end of the range
    assert (_least(edge)[0] == OFFSETS_PX[0]).all()


def test_what_a_depth_leads_to_agrees_with_itself(views: list[FittedView]) -> None:
    """The plane's depths meet in the other view; an offset is measured in px."""
    depths = plane_depths(views)
    seen = reprojected(views[0], depths[0], views[1])
    assert seen.where.mean() > 0.6
    inner = seen.where & (seen.column > 0) & (seen.column < SIDE - 1) & (seen.row > 0) & (seen.row < SIDE - 1)
    assert disagreement(views[0], seen, views[1], depths[1])[inner].max() < 0.01  # its depth between pixels is no line
    nearer = 1 / (1 / depths[1] + 2 / pixels_per_inverse_depth(views[0], views[1]))
    assert np.abs(disagreement(views[0], seen, views[1], nearer)[inner] - 2).max() < 0.02
