"""A given range beyond whose ends part of the photographs matches is told, by the end and the depths that it misses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sample_matches import sample
from sample_photographs import FAR, NEAR, sample_cameras, sample_pixels

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.depth_range import DepthRange
from gapmes.service.matching.missed_depths import missed_depths
from gapmes.service.matching.pair_matches import PairMatches
from gapmes.service.photographs.images import FittedView
from gapmes.service.reconstruct import Reconstructor

SIDE, FOCAL, BASELINE = 256, 256.0, 0.5
BOARD, WALL = 2.0, 4.0  # depths


def board_before_wall() -> list[FittedView]:
    """Two views side by side of a board of a fifth of the picture before a wall, both parallel to the picture."""
    rng = np.random.default_rng(3)
    wall, board = (np.kron(rng.uniform(size=(64, 128)), np.ones((4, 4))) for _ in range(2))
    views = []
    for left in (0.0, BASELINE):
        by_wall, by_board = (round(FOCAL * left / depth) for depth in (WALL, BOARD))
        picture = wall[:, by_wall : by_wall + SIDE].copy()
        columns = slice(120 - by_board, 220 - by_board)
        picture[60:190, columns] = board[60:190, 120:220]
        pose = np.eye(4)
        pose[0, 3] = left
        camera = Camera.make(SIDE, SIDE, FOCAL, FOCAL, SIDE / 2, SIDE / 2, pose)
        views.append(FittedView(np.repeat(picture[None].astype(np.float32), 3, axis=0), None, camera, 1.0))
    return views


@pytest.mark.parametrize(
    ("near", "far", "end", "depth"), [(2.8, 8.0, "near", BOARD), (1.0, 3.0, "far", WALL), (1.4, 8.0, None, 0)]
)
def test_the_end_and_the_depths_beyond_it_are_told(near: float, far: float, end: str | None, depth: float) -> None:
    notices = missed_depths(PairMatches(board_before_wall(), DepthRange(near, far, "given")))
    assert [(notice["code"], notice["field"]) for notice in notices] == [("depth_range_doubtful", end)] * bool(end)
    for notice in notices:
        low, high = (float(word) for word in notice["message"].split("at depths of ")[1].split(" (")[0].split(" to "))
        assert low == pytest.approx(depth, rel=0.1)
        assert high == pytest.approx(depth, rel=0.1)
        where, limit = ("nearer", near) if end == "near" else ("farther", far)
        assert f"lies {where} than {end} = {limit:.4g}, " in notice["message"]


def test_an_estimate_is_not_judged() -> None:
    for source in ("estimated", "narrowed"):
        assert missed_depths(PairMatches(board_before_wall(), DepthRange(2.8, 8.0, source))) == []


def test_where_nothing_matches_nothing_is_told() -> None:
    views = board_before_wall()
    views[0].image[:] = 0.5
    assert missed_depths(PairMatches(views, DepthRange(2.8, 8.0, "given"))) == []


@pytest.mark.parametrize("which", [(1, 5), (0, 3, 7), (0, 7)])
@pytest.mark.parametrize(("near", "far"), [(1, 1), (0.5, 1), (1, 2)])
def test_a_right_range_of_a_real_scene_passes(which: tuple[int, ...], near: float, far: float) -> None:
    pairs = sample(which)
    assert missed_depths(PairMatches(pairs.views, DepthRange(near * NEAR, far * FAR, "given"))) == []


def test_a_reconstruction_tells_of_it(engine: Any) -> None:
    pixels, cameras = [sample_pixels(view) for view in (1, 5)], sample_cameras((1, 5))
    codes = [
        [(notice["code"], notice["field"]) for notice in scene.document["warnings"]]
        for scene in (
            Reconstructor(engine).reconstruct(pixels, cameras, near=near * NEAR, far=FAR, fade=0) for near in (1.0, 1.5)
        )
    ]
    assert [("depth_range_doubtful", "near") in each for each in codes] == [False, True]
