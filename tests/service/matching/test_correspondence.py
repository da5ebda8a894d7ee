"""Which other views determine a view's depths: those with parallax, however far away another one is."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.matching.correspondence import LEAST_BASELINE, PARALLAX_PX, views_with_parallax
from gapmes.service.photographs.images import FittedView

DEPTH = np.full((32, 32), 6.0)


def view(x: float, z: float = 0.0, mask: np.ndarray | None = None) -> FittedView:
    pose = np.eye(4)
    pose[:3, 3] = x, 0.0, z
    camera = Camera.make(32, 32, 60.0, 60.0, 16.0, 16.0, pose)
    return FittedView(np.zeros((3, 32, 32), np.float32), mask, camera, 1.0)


def test_an_overview_from_far_away_leaves_neighbours_in() -> None:
    """0.45 to the side moves what is 6 away by 4.5 px, and is 1/27 of the way to the overview."""
    assert list(views_with_parallax([view(0), view(0.45), view(0, -12)], 0, DEPTH)) == [1, 2]


@pytest.mark.parametrize(("x", "found"), [(0.39, [2]), (0.41, [1, 2])])
def test_from_nearly_the_same_place_is_told_by_parallax(x: float, found: list[int]) -> None:
    """4 px are 0.4 units at 6; without the limit of PARALLAX_PX both were less than LEAST_BASELINE."""
    assert pytest.approx(PARALLAX_PX) == 60 * 0.4 / 6
    assert LEAST_BASELINE * 12 > 0.41
    assert list(views_with_parallax([view(0), view(x), view(0, -12)], 0, DEPTH)) == found


def test_what_a_mask_leaves_out_has_no_say() -> None:
    mask = np.zeros((32, 32), bool)
    mask[:4] = True
    depth = np.where(mask, 6.0, 1e-3)
    assert list(views_with_parallax([view(0, mask=mask), view(0.39), view(0, -12)], 0, depth)) == [2]
    assert list(views_with_parallax([view(0), view(0.39), view(0, -12)], 0, depth)) == [1, 2]


def test_the_same_place_tells_nothing_whatever_the_scale() -> None:
    assert views_with_parallax([view(0), view(0)], 0, DEPTH) == {}
    assert list(views_with_parallax([view(0), view(1e-9), view(0)], 0, DEPTH)) == [1]
