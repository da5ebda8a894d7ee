"""The heavy-ball method: steps, their momentum and limits."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.service.mending.heavy_ball import MOMENTUM, HeavyBall


def test_a_step_goes_on_by_its_share() -> None:
    ball = HeavyBall(np.zeros(2, np.float32), -10.0, 10.0)
    way, expected = 0.0, []
    for step in (0.1, 0.1, 0.0, -0.3):
        way = step + MOMENTUM * way
        expected.append(way)
        ball.move(np.array([step, -step]))
        assert ball.now == pytest.approx([sum(expected), -sum(expected)], abs=1e-6)
    assert expected[1] == pytest.approx(0.14)
    assert expected[2] == pytest.approx(0.056)
    assert ball.now.dtype == np.float32


def test_the_way_that_a_limit_cuts_off_is_not_kept() -> None:
    least, most = np.array([0.0, 0.2], np.float32), np.array([1.0, 0.9], np.float32)
    ball = HeavyBall(np.array([0.5, 0.8], np.float32), least, most)
    ball.move(np.array([-5.0, 5.0]))
    assert (ball.now == [0.0, np.float32(0.9)]).all()
    ball.move(np.zeros(2))  # held at the limit, the momentum of the way that was left
    assert (ball.now == [0.0, np.float32(0.9)]).all()
    ball.move(np.array([0.3, -0.3]))  # back inside at once
    assert ball.now == pytest.approx([0.3, 0.6], abs=1e-6)


def test_steps_beyond_float32_end_at_a_limit() -> None:
    ball = HeavyBall(np.zeros(2, np.float32), 0.0, 1.0)
    ball.move(np.array([1e300, -1e300]))
    assert (ball.now == [1, 0]).all()
    ball.move(np.array([-1e300, 1e300]))
    assert (ball.now == [0, 1]).all()


def test_what_started_beyond_a_limit_may_go_back_there_and_no_farther() -> None:
    ball = HeavyBall(np.array([-0.5, 1.5], np.float32), 0.0, 1.0)
    for step, found in (([0.2, -0.2], [-0.3, 1.3]), ([-9.0, 9.0], [-0.5, 1.5]), ([9.0, -9.0], [1.0, 0.0])):
        ball.move(np.array(step))
        assert ball.now == pytest.approx(found, abs=1e-6)
