"""The minimum spanning tree of cameras: the least length in any order, ties by the order."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise, permutations

import numpy as np
import pytest

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.rotations import about_axis
from gapmes.service.cameras.spanning_tree import first_joined, minimum_spanning_tree


def at(*centers: Sequence[float]) -> list[Camera]:
    cameras = []
    for center in centers:
        pose = np.eye(4)
        pose[:3, 3] = center
        cameras.append(Camera.make(64, 48, 60.0, 60.0, 32.0, 24.0, pose))
    return cameras


def length(cameras: Sequence[Camera], ways: Sequence[tuple[int, int]]) -> float:
    return sum(float(np.linalg.norm(cameras[i].center - cameras[j].center)) for i, j in ways)


def joins_all(count: int, ways: Sequence[tuple[int, int]]) -> bool:
    reached = {0}
    for _ in ways:
        reached |= {place for way in ways if reached & set(way) for place in way}
    return len(reached) == count


def test_a_path_is_walked_along() -> None:
    for count in range(2, 7):
        cameras = at(*([0.4 * step, 0.02 * step**2, 0.01 * step] for step in range(count)))
        assert minimum_spanning_tree(cameras) == list(pairwise(range(count)))


@pytest.mark.parametrize("seed", range(5))
def test_no_tree_is_shorter(seed: int) -> None:
    cameras = at(*np.random.default_rng(seed).normal(size=(5, 3)))
    found = minimum_spanning_tree(cameras)
    assert joins_all(5, found)
    trees = [ways for ways in combinations(combinations(range(5), 2), 4) if joins_all(5, ways)]
    assert len(trees) == 5**3
    assert length(cameras, found) == pytest.approx(min(length(cameras, ways) for ways in trees))


def test_the_order_of_cameras_does_not_matter() -> None:
    cameras = at(*np.random.default_rng(7).normal(size=(5, 3)))
    expected = {frozenset(way) for way in minimum_spanning_tree(cameras)}
    for order in permutations(range(5)):
        assert {
            frozenset(order[end] for end in way) for way in minimum_spanning_tree([cameras[place] for place in order])
        } == expected


@pytest.mark.parametrize("seed", range(20))
def test_of_equal_ways_those_along_the_order_are_taken_in_any_world(seed: int) -> None:
    """Cameras around a square: its four sides are equally long up to rounding."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = about_axis(axis / np.linalg.norm(axis), rng.uniform(0, 3))
    cameras = at(*(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) @ turn.T + rng.normal(size=3)))
    assert minimum_spanning_tree(cameras) == [(0, 1), (1, 2), (2, 3)]


def test_cameras_in_one_place_are_joined_too() -> None:
    assert minimum_spanning_tree(at([1, 2, 3], [1, 2, 3])) == [(0, 1)]
    assert minimum_spanning_tree(at([1, 2, 3])) == []


@pytest.mark.parametrize(
    ("edges", "first"),
    [([], [0, 1, 2, 3, 4]), ([(3, 4), (1, 3)], [0, 1, 2, 1, 1]), ([(2, 4), (1, 3), (3, 4), (0, 1)], [0] * 5)],
)
def test_what_edges_join_goes_by_its_lowest_index(edges: list[tuple[int, int]], first: list[int]) -> None:
    for order in permutations(edges):
        assert first_joined(5, order) == first
