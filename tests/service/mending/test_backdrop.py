"""The backdrop: behind every surface, around every photograph, in its colours, and without holes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plane_views import SIDE, in_another_world, plane_depths

from gapmes.service.cameras.rotations import (
    about_axis,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_product,
)
from gapmes.service.harmonics import C0
from gapmes.service.mending.backdrop import CELL, MARGIN, PUSH_BACK, RINGS, backdrop
from gapmes.service.photographs.images import FittedView
from gapmes.service.splat import render

CELLS = SIDE // CELL
SHEET = (CELLS + 2 * sum(MARGIN)) ** 2
AROUND = (CELLS + 2 * len(MARGIN) + 2 * len(RINGS)) ** 2 - SHEET


@pytest.fixture(scope="module")
def depths(views: list[FittedView]) -> np.ndarray:
    return plane_depths(views)


def test_one_for_each_cell(views: list[FittedView], depths: np.ndarray) -> None:
    for coefficients in (1, 4):
        sheet, around = backdrop(views, depths, coefficients)
        assert (len(sheet), around) == (3 * (SHEET + AROUND), 3 * SHEET)
        assert sheet.harmonics.shape[1] == coefficients
        assert (sheet.harmonics[:, 1:] == 0).all()


def test_it_stands_behind_its_surface(views: list[FittedView], depths: np.ndarray) -> None:
    sheet, around = backdrop(views[:1], depths[:1], 1)
    pixels, z = views[0].camera.project(sheet.means)
    inside = ((pixels > 0) & (pixels < SIDE)).all(axis=1)
    assert inside.sum() == CELLS**2
    column, row = pixels[inside].astype(int).T
    assert (z[inside] >= depths[0][row, column] / PUSH_BACK * (1 - 1e-9)).all()
    assert z.max() <= depths[0].max() / PUSH_BACK * (1 + 1e-9)
    assert not inside[around:].any()
    thin = matrix_from_quaternion(sheet.rotations_wxyz)[:, :, 2]  # the axis of the least scale looks at the camera
    assert np.abs(thin @ views[0].camera.rotation[:, 2]) == pytest.approx(1, abs=1e-6)
    assert (sheet.scales.argmin(axis=1) == 2).all()
    reach = CELL * (sum(MARGIN) + sum(RINGS))
    assert pixels.min() > -reach
    assert pixels.max() < SIDE + reach


@pytest.mark.parametrize(("beyond", "least"), [(SIDE // 2, 0.9), (440, 0.85)])
def test_no_hole_far_beyond_the_border(views: list[FittedView], depths: np.ndarray, beyond: int, least: float) -> None:
    """So many px to each side are covered, corners included, of 512."""
    assert CELL * (sum(MARGIN) + sum(RINGS)) == 512
    sheet, _ = backdrop(views[:1], depths[:1], 1)
    wide = views[0].camera.cropped(-beyond, -beyond, SIDE + 2 * beyond, SIDE + 2 * beyond)
    assert render(sheet, wide, outputs=("alpha",)).alpha.min() > least  # found: 0.93 and 0.89


def test_a_gap_shows_the_farther_surface(views: list[FittedView]) -> None:
    """A near red strip before a far green wall: behind the strip and beyond it the sheet is green and far."""
    strip = (np.arange(SIDE) >= 3 * CELL) & (np.arange(SIDE) < 4 * CELL)  # a whole column of cells
    image = np.zeros((3, SIDE, SIDE), np.float32)
    image[0, :, strip], image[1, :, ~strip] = 0.9, 0.7
    depth = np.where(strip, 1.0, 4.0) * np.ones((SIDE, 1))
    sheet, _ = backdrop([replace(views[0], image=image)], depth[None], 1)
    colours = 0.5 + C0 * sheet.harmonics[:, 0]
    assert np.abs(colours - (0, 0.7, 0)).max() < 1e-3
    assert np.abs(views[0].camera.project(sheet.means)[1] - 4 / PUSH_BACK).max() < 1e-6


def test_behind_something_wide_stands_what_lies_about_it(views: list[FittedView]) -> None:
    """A near red box, six cells wide, before a far green wall: from the side the wall goes on behind it."""
    box = np.zeros((SIDE, SIDE), bool)
    box[CELL : 7 * CELL, CELL : 7 * CELL] = True
    image = np.zeros((3, SIDE, SIDE), np.float32)
    image[0, box], image[1, ~box] = 0.9, 0.7
    depth = np.where(box, 1.0, 4.0)
    sheet, around = backdrop([replace(views[0], image=image)], depth[None], 1)
    pixels, z = views[0].camera.project(sheet.means)
    second = np.abs(z - 4 / PUSH_BACK**2) < 1e-6
    assert second[:around].sum() == second.sum() == 4 * 4  # the cells that have the box all about them
    assert ((pixels[second] > 2 * CELL) & (pixels[second] < 6 * CELL)).all()
    colours = 0.5 + C0 * sheet.harmonics[:, 0]
    assert np.abs(colours[second] - (0, 0.7, 0)).max() < 1e-3
    assert (np.abs(z[~second & ((pixels > 2 * CELL) & (pixels < 6 * CELL)).all(axis=1)] - 1 / PUSH_BACK) < 1e-6).all()

    pose = views[0].camera.world_from_cam.copy()
    pose[:3, 3] -= 0.6 * views[0].camera.rotation[:, 0]
    aside = views[0].camera.posed(pose)
    assert render(sheet, aside, outputs=("alpha",)).alpha.min() > 0.9  # found: 0.93
    assert render(sheet[~second], aside, outputs=("alpha",)).alpha.min() < 0.01  # found: 0


def test_how_far_behind_a_wide_thing_the_second_sheet_goes(views: list[FittedView]) -> None:
    """Five cells inwards from the edge of a box of 14, and no farther; above them the wall, twice pushed back."""
    side = 24 * CELL
    camera = replace(views[0].camera, width=side, height=side)
    image = np.ones((3, side, side), np.float32)
    depth = np.full((side, side), 4.0)
    depth[5 * CELL : 19 * CELL, 5 * CELL : 19 * CELL] = 1.0
    sheet, around = backdrop([replace(views[0], image=image, camera=camera)], depth[None], 1)
    pixels, z = camera.project(sheet.means[:around])
    second = pixels[np.abs(z - 4 / PUSH_BACK**2) < 1e-6]
    inwards = np.minimum(second - 5 * CELL, 19 * CELL - second).min(axis=1) / CELL
    assert sorted(set(np.floor(inwards))) == [1, 2, 3, 4]  # the outermost cells have the wall behind them anyway
    assert len(second) == 12**2 - 4**2


def test_a_second_sheet_of_each_view_in_its_order(views: list[FittedView], depths: np.ndarray) -> None:
    depths = depths.copy()
    depths[:, CELL : 7 * CELL, CELL : 7 * CELL] /= 4
    sheet, around = backdrop(views, depths, 1)
    assert around == 3 * (SHEET + 16)
    assert len(sheet) == around + 3 * AROUND
    alone = [backdrop([view], depth[None], 1) for view, depth in zip(views, depths, strict=True)]
    behind = np.concatenate([one.means[:count] for one, count in alone])
    rings = np.concatenate([one.means[count:] for one, count in alone])
    assert (sheet.means == np.concatenate([behind, rings])).all()


@pytest.mark.parametrize(("wall", "second"), [(1.15, 0), (1.2, 4 * 4)])
def test_how_much_farther_a_wall_gets_a_second_sheet(views: list[FittedView], wall: float, second: int) -> None:
    """A box six cells wide, and a wall behind it at 0.87 and at 0.83 of its inverse depth."""
    depth = np.full((SIDE, SIDE), wall)
    depth[CELL : 7 * CELL, CELL : 7 * CELL] = 1.0
    sheet, around = backdrop([views[0]], depth[None], 1)
    assert around == SHEET + second
    behind = np.abs(views[0].camera.project(sheet.means[:around])[1] - wall / PUSH_BACK**2) < 1e-6
    assert behind.sum() == second


@pytest.mark.parametrize("degrees", [20, 45])
def test_a_slanted_wall_has_no_second_sheet(views: list[FittedView], degrees: float) -> None:
    """Nothing opens behind it: from cell to cell it recedes too little. Cells as in 256 px at 53 degrees."""
    camera = replace(views[0].camera, fx=256.0, fy=256.0)
    slope = np.tan(np.deg2rad(degrees)) * (np.arange(SIDE) + 0.5 - SIDE / 2) / camera.fx
    depth = 4.0 / (1 - slope)[None] * np.ones((SIDE, 1))
    sheet, around = backdrop([replace(views[0], camera=camera)], depth[None], 1)
    assert (around, len(sheet)) == (SHEET, SHEET + AROUND)


def test_a_masked_photograph_has_no_second_sheet(views: list[FittedView]) -> None:
    """It would stand beside the object, in what the mask left out."""
    depth = np.full((SIDE, SIDE), 4.0)
    depth[CELL : 7 * CELL, CELL : 7 * CELL] = 1.0
    mask = np.ones((SIDE, SIDE), bool)
    mask[0, 0] = False
    sheet, around = backdrop([replace(views[0], mask=mask)], depth[None], 1)
    assert around == len(sheet) == SHEET


def test_a_ring_stands_behind_all_that_is_as_near_as_it_reaches(views: list[FittedView]) -> None:
    """Something near at the right border goes on beside it, not far out, where it would hide the wall."""
    depth = np.full((SIDE, SIDE), 4.0)
    depth[2 * CELL : 6 * CELL, -4 * CELL :] = 1.0
    sheet, around = backdrop(views[:1], depth[None], 1)
    pixels, z = views[0].camera.project(sheet.means)
    beside = (pixels[:, 0] > SIDE) & (np.abs(pixels[:, 1] - SIDE / 2) < CELL)
    assert z[:around][beside[:around]] == pytest.approx(1 / PUSH_BACK)
    ring = z[around:][beside[around:]]
    assert ring[np.argsort(pixels[around:, 0][beside[around:]])] == pytest.approx(4 / PUSH_BACK)


def test_a_hidden_depth_does_not_matter(views: list[FittedView], depths: np.ndarray) -> None:
    mask = np.ones((SIDE, SIDE), bool)
    mask[:CELL, :CELL] = False
    masked = [replace(views[0], mask=mask)]
    sets = []
    for hidden in (1e-3, 4.0, 1e6):
        changed = depths[:1].copy()
        changed[0][~mask] = hidden
        sets.append(backdrop(masked, changed, 1)[0])
    for other in sets[1:]:
        assert (other.means == sets[0].means).all()
        assert (other.harmonics == sets[0].harmonics).all()


@pytest.mark.filterwarnings("error")
def test_units_at_the_end_of_float32(views: list[FittedView], depths: np.ndarray) -> None:
    depths = depths.copy()
    depths[:, CELL : 7 * CELL, CELL : 7 * CELL] /= 4
    for unit in (1e-30, 1e30, 1e38):
        moved = in_another_world(views, np.eye(3), np.zeros(3), unit)
        sheet, _ = backdrop(moved, unit * depths, 1)
        assert np.isfinite(sheet.scales).all()


def test_where_a_mask_keeps_nothing_nothing_stands(views: list[FittedView], depths: np.ndarray) -> None:
    left = np.arange(SIDE)[None] < np.full((SIDE, 1), SIDE // 2)
    masked = replace(views[0], mask=left, image=np.where(left, views[0].image, 1.0).astype(np.float32))
    sheet, around = backdrop([masked], depths[:1], 1)
    pixels, _ = views[0].camera.project(sheet.means)
    assert (pixels[:, 0] < SIDE // 2).all()
    assert 0 < around == len(sheet) < SHEET  # a mask says what is to be seen: no ring about it
    other = replace(masked, image=np.where(left, views[0].image, 0.0).astype(np.float32))
    again, _ = backdrop([other], depths[:1], 1)
    assert (again.harmonics == sheet.harmonics).all()  # what the mask hides may be anything
    nothing, none = backdrop([replace(views[0], mask=np.zeros((SIDE, SIDE), bool))], depths[:1], 1)
    assert (len(nothing), none) == (0, 0)


def test_one_depth_everywhere_is_a_range_of_nothing(views: list[FittedView]) -> None:
    sheet, _ = backdrop(views[:1], np.full((1, SIDE, SIDE), 3.0), 1)
    assert np.isfinite(sheet.harmonics).all()
    assert np.abs(views[0].camera.project(sheet.means)[1] - 3 / PUSH_BACK).max() < 1e-6


def test_a_wide_picture_has_its_cells(views: list[FittedView]) -> None:
    camera = replace(views[0].camera, width=2 * SIDE)
    wide = replace(views[0], image=np.concatenate([views[0].image] * 2, axis=2), camera=camera)
    sheet, around = backdrop([wide], np.full((1, SIDE, 2 * SIDE), 3.0), 1)
    extra = 2 * (len(MARGIN) + len(RINGS))
    assert len(sheet) == (CELLS + extra) * (2 * CELLS + extra)
    assert around == (CELLS + 2 * sum(MARGIN)) * (2 * CELLS + 2 * sum(MARGIN))


def test_the_world_and_its_unit_do_not_matter(views: list[FittedView], depths: np.ndarray) -> None:
    turn, shift = about_axis(np.array([0.48, -0.6, 0.64]), 2.3), np.array([5e4, -2e4, 1e4])
    moved, _ = backdrop(in_another_world(views, turn, shift, 300.0), 300.0 * depths, 1)
    here, _ = backdrop(views, depths, 1)
    assert np.abs(moved.means - (300.0 * here.means @ turn.T + shift)).max() < 1e-6
    assert moved.scales == pytest.approx(300 * here.scales, rel=1e-5)
    turned = quaternion_product(quaternion_from_matrix(turn), here.rotations_wxyz)
    assert np.abs((turned * moved.rotations_wxyz).sum(axis=1)) == pytest.approx(1, abs=1e-6)
    assert moved.harmonics == pytest.approx(here.harmonics, abs=1e-5)
