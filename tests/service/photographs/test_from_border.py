"""Regions connected to the border of the picture: against a flood fill, and on winding paths."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from gapmes.service.photographs.from_border import from_border


@pytest.mark.parametrize("share", [0.3, 0.55, 0.65, 0.95, 1.0])
def test_what_is_joined_to_the_border_is_what_a_walk_from_there_reaches(share: float) -> None:
    rng = np.random.default_rng(int(100 * share))
    for shape in ((23, 31), (1, 9), (9, 1)):
        black = rng.uniform(size=shape) < share
        reached = np.zeros(shape, np.bool_)
        rows, columns = shape
        steps = deque(
            (j, i) for j in range(rows) for i in range(columns) if j in (0, rows - 1) or i in (0, columns - 1)
        )
        while steps:
            j, i = steps.popleft()
            if 0 <= j < rows and 0 <= i < columns and black[j, i] and not reached[j, i]:
                reached[j, i] = True
                steps.extend([(j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1)])
        assert (from_border(black) == reached).all()


def test_a_spiral_is_followed_to_its_end() -> None:
    black = np.zeros((25, 25), np.bool_)
    j, i, dj, di = 0, 0, 0, 1
    black[j, i] = True
    for length in (24, 24, 24, 22, 22, 20, 20, 18, 18, 16, 16, 14, 14, 12, 12, 10, 10, 8, 8, 6, 6, 4, 4):
        for _ in range(length):
            j, i = j + dj, i + di
            black[j, i] = True
        dj, di = di, -dj
    assert (from_border(black) == black).all()


def test_stairs_that_turn_at_both_ends_are_followed() -> None:
    """A way of single steps, which sweeps over rows and columns would follow by one step each."""
    mask, j, i = np.zeros((41, 61), np.bool_), 0, 0
    mask[j, i] = True
    for flight in range(4):
        for _ in range(9):
            for dj, di in ((1, 0), (0, 1)) if flight % 2 == 0 else ((-1, 0), (0, 1)):
                j, i = j + dj, i + di
                mask[j, i] = True
    inner = mask.copy()
    inner[0, 0] = False
    assert (from_border(mask) == mask).all()
    assert not from_border(np.pad(inner, 1))[1:-1].any()
