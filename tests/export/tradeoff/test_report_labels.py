"""Labels in the report's plot hide neither points nor each other, and stand at their own points."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gapmes.export.tradeoff.labels import MARKER, SIDES, labels, spread


def figure(points: np.ndarray, *, joined: bool = False, bold: int | None = None) -> tuple[Figure, Axes]:
    """A panel with a labelled point at each of the positions (N, 2)."""
    made = Figure(figsize=(4, 4), dpi=100, layout="constrained")
    axes = made.subplots()
    axes.plot(*points.T, "o-" if joined else "o", markersize=5, label="knob")
    for number, (x, y) in enumerate(points):
        weight = "bold" if number == bold else "normal"
        axes.annotate(f"{number}/255", (x, y), (0, 0), textcoords="offset points", fontsize=7, weight=weight)
    axes.axhline(points[:, 1].max() + 1)
    axes.margins(0.2)
    return made, axes


@pytest.mark.parametrize("joined", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_hidden_where_there_is_room(seed: int, joined: bool) -> None:
    """Eleven points, three of which are close together."""
    grid = 4.0 * np.stack(np.meshgrid(np.arange(3), np.arange(3)), axis=-1).reshape(-1, 2)
    points = grid + np.random.default_rng(seed).uniform(-0.7, 0.7, grid.shape)
    points = np.concatenate([points, points[4] + [[0.4, 0.1], [0.1, -0.4]]])
    made, axes = figure(points, joined=joined)
    spread(made)
    boxes = [label.get_window_extent() for label in labels(axes)]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    places = axes.transData.transform(points)
    inside = axes.get_window_extent()
    for number, box in enumerate(boxes):
        away = np.maximum(np.maximum(box.min - places, places - box.max), 0)
        distance = np.hypot(*away.T)
        assert distance.argmin() == number
        assert (np.abs(away).max(axis=1) >= MARKER - 1).all()
        assert inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1  # noqa: PT018


def test_a_cluster_keeps_its_labels_from_a_point_close_by() -> None:
    """Three points in one place, and one on the same line 25 px to the right, as for settings of nearly equal time."""
    points = np.array([[0.0, 0.0], [5.0, 5.0], [5.05, 5.02], [5.1, 5.0], [6.0, 5.0], [10.0, 10.0]])
    made, axes = figure(points, joined=True, bold=2)
    spread(made)
    made.canvas.draw()
    places = axes.transData.transform(points)
    for number, label in enumerate(labels(axes)[1:5], 1):
        box = label.get_window_extent()
        distance = np.hypot(*np.maximum(np.maximum(box.min - places, places - box.max), 0).T)
        assert (distance[4] < distance[1:4].min()) == (number == 4)


def test_a_label_with_room_goes_to_the_first_side_and_off_its_line_to_another() -> None:
    far = np.array([[0.0, 0.0], [10.0, 10.0]])
    made, axes = figure(far)
    spread(made)
    assert [label.xyann for label in labels(axes)] == [SIDES[0][:2]] * 2
    made, axes = figure(far, joined=True)
    spread(made)
    assert labels(axes)[0].xyann != SIDES[0][:2]


def test_the_default_has_the_first_choice() -> None:
    together = np.array([[5.0, 5.0], [5.0, 5.0], [0.0, 0.0], [10.0, 10.0]])
    made, axes = figure(together, bold=1)
    spread(made)
    other, default, *_ = labels(axes)
    assert default.xyann == SIDES[0][:2]
    assert other.xyann != SIDES[0][:2]
