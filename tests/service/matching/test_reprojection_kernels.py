"""Where other views see pixels, and their values there: the compiled loops against cameras and numpy, to the bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.matching.correspondence import Reprojection, reprojected
from gapmes.service.matching.reprojection_kernels import FARTHEST, sample_bilinear
from gapmes.service.photographs.bilinear import bilinear
from gapmes.service.photographs.images import FittedView

WIDTH, HEIGHT = 24, 17
LENS = (WIDTH, HEIGHT, 21.3, 19.7, 11.1, 8.9)
OTHER = (19, 29, 17.2, 18.9, 10.3, 13.7)


def view(turn: float, shift: tuple[float, float, float], lens: tuple = LENS) -> FittedView:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = about_axis(np.array([0.36, 0.48, -0.8]), turn), shift
    return FittedView(np.zeros((3, lens[1], lens[0]), np.float32), None, Camera.make(*lens, pose), 1.0)


def by_camera(here: FittedView, depth: np.ndarray, there: FittedView) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 2) and (H, W)"""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    points = here.camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1), depth.ravel())
    pixels, z = there.camera.project(points)
    return pixels.reshape(HEIGHT, WIDTH, 2), z.reshape(HEIGHT, WIDTH)


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize(("turn", "ahead"), [(0.2, 0.1), (0.9, 2.0), (3.0, 0.0)])
def test_places_are_those_of_the_cameras(turn: float, ahead: float, offset: float) -> None:
    here, there = view(-0.1, (offset, 0.2, 0.0)), view(turn, (offset + 0.4, -0.1, ahead), OTHER)
    depth = np.random.default_rng(1).uniform(0.5, 4, (HEIGHT, WIDTH))
    found: Reprojection = reprojected(here, depth, there)
    pixels, z = by_camera(here, depth, there)
    before = z > 0
    inside = before & ((pixels > 0) & (pixels < OTHER[:2])).all(axis=2)
    assert (found.inside == inside).all()
    assert (found.where == inside).all()
    assert (found.z == np.where(inside, z, 1.0)).all()
    assert (found.column[before] == pixels[before][:, 0] - 0.5).all()
    assert (found.row[before] == pixels[before][:, 1] - 0.5).all()
    assert (found.column[~before] == -1.5).all()
    assert (found.row[~before] == -1.5).all()
    assert before.mean() > 0 or turn == 3.0
    assert np.isfinite(found.column).all()


def test_a_mask_hides_what_is_inside() -> None:
    here, there = view(-0.1, (0.0, 0.2, 0.0)), view(0.1, (0.4, -0.1, 0.1), OTHER)
    depth = np.random.default_rng(1).uniform(0.5, 4, (HEIGHT, WIDTH))
    mask = np.ones((OTHER[1], OTHER[0]), bool)
    mask[:14] = False
    bare, masked = reprojected(here, depth, there), reprojected(here, depth, replace(there, mask=mask))
    assert (masked.inside == bare.inside).all()
    assert (masked.where == bare.inside & (bare.row >= 14)).all()  # in full on what the mask keeps
    assert 0 < masked.where.sum() < bare.inside.sum()
    assert (masked.z == np.where(masked.where, bare.z, 1.0)).all()


@pytest.mark.parametrize("depth", [np.nan, np.inf, -np.inf, 0.0])
def test_depths_that_are_none_stay_outside(depth: float) -> None:
    """Of 0 is the place of the camera itself, behind the other here."""
    found = reprojected(view(0.0, (0.0, 0.0, 0.0)), np.full((HEIGHT, WIDTH), depth), view(0.0, (0.3, 0.0, 0.5)))
    assert not found.inside.any()
    assert np.isfinite(found.z).all()
    assert (found.column == -1.5).all()
    assert (found.row == -1.5).all()


def test_a_point_on_the_plane_of_the_other_camera_is_not_in_its_picture() -> None:
    here, there = view(0.0, (0.0, 0.0, 0.0)), view(0.0, (0.3, 0.0, 2.0))
    found = reprojected(here, np.full((HEIGHT, WIDTH), 2.0), there)
    assert not found.inside.any()
    assert (found.column == -1.5).all()
    assert (found.row == -1.5).all()


def test_a_point_beside_the_other_camera_is_far_off_its_picture() -> None:
    """All but on the plane of its centre, where its place overflows."""
    here, there = view(0.0, (0.0, 0.0, 0.0)), view(0.0, (-1e100, 0.0, 1e-300))
    found = reprojected(here, np.full((HEIGHT, WIDTH), np.nextafter(1e-300, 1.0)), there)
    assert (found.column == FARTHEST - 0.5).all()
    assert np.isfinite(found.row).all()
    assert not found.inside.any()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_what_is_there_is_what_numpy_finds(channels: int, kind: type) -> None:
    rng = np.random.default_rng(channels)
    values = rng.normal(size=(HEIGHT, WIDTH, channels)).astype(kind)
    column, row = rng.uniform(-3, WIDTH + 3, (9, 40)), rng.uniform(-3, HEIGHT + 3, (9, 40))
    found = np.empty((9, 40, channels), kind)
    sample_bilinear(values, column, row, found)
    expected = bilinear(values, column, row)
    assert expected.dtype == kind
    assert (found == expected).all()
    seen = Reprojection(column, row, np.ones((9, 40)), np.ones((9, 40), bool), np.ones((9, 40), bool))
    turned = np.ascontiguousarray(values.transpose(2, 0, 1)).transpose(1, 2, 0)  # as pictures are kept
    assert (seen.value(turned) == expected).all()
