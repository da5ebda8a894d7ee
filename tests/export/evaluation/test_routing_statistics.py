"""Routing statistics against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gapmes.export.evaluation.routing import routing_statistics


def test_routing_statistics_by_hand() -> None:
    routes = [
        {"expert_index": np.array([[0, 2], [2, 1]]), "task_weight": np.array([[1, 0, 0, 0], [0, 1, 0, 0]], np.float32)},
        {"expert_index": np.array([[2, 0]]), "task_weight": np.array([[0.4, 0.2, 0.2, 0.2]], np.float32)},
    ]
    result = routing_statistics(routes, 4, None)
    assert result is not None
    assert result.expert_share == pytest.approx([2 / 6, 1 / 6, 3 / 6, 0])
    values = np.array([1, 0, 0.4])
    assert result.task_mean["mean"] == pytest.approx(values.mean())
    assert result.task_deviation["mean"] == pytest.approx(values.std())
    assert routing_statistics([{}], 4, None) is None
    unnumbered = routing_statistics(routes, None, None)
    assert unnumbered is not None
    assert unnumbered.expert_share == []
