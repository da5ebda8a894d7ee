"""Placement of point labels in a panel: least overlap, and each closest to its own point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

# Points to the right and up, and which edge of the text stands there: nearer ones first
SIDES = (
    *((6, 3, "left"), (-6, 4, "right"), (6, -9, "left"), (-6, -9, "right"), (0, 7, "center"), (0, -13, "center")),
    *((12, 9, "left"), (-12, 9, "right"), (12, -15, "left"), (-12, -15, "right"), (0, 15, "center")),
    *((0, -21, "center"), (16, 0, "left"), (-16, 0, "right"), (0, 23, "center"), (18, 17, "left"), (-18, 17, "right")),
)
MARKER = 4.0  # px, half of a point's side
STRANGE = 200.0  # px^2 that may be hidden rather than that another point is nearer
ON_A_LINE = 0.2  # px^2 that may be hidden rather than one px of a line


def spread(figure: Figure) -> None:
    """Place the labels at data points in all panels, bold ones first."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # sizes of texts and places of panels are known from here on, and stay
    figure.set_layout_engine("none")
    for axes in figure.axes:
        panel = _Panel(axes)
        for label in sorted(labels(axes), key=lambda label: label.get_fontweight() != "bold"):
            costs = [panel.cost(_box(label, side, canvas), label.xy) for side in SIDES]
            panel.taken.append(_box(label, SIDES[int(np.argmin(costs))], canvas))  # the first of equals


def labels(axes: Axes) -> list[Annotation]:
    """Of the points of a panel."""
    return [text for text in axes.texts if isinstance(text, Annotation) and text.xycoords == "data"]


class _Panel:
    """The contents of a panel that labels should not cover."""

    def __init__(self, axes: Axes) -> None:
        self._axes, self._inside = axes, axes.get_window_extent()
        marked = [line.get_xydata() for line in axes.lines if line.get_marker() != "None"]
        self._points = axes.transData.transform(np.unique(np.concatenate([np.empty((0, 2)), *marked]), axis=0))
        drawn = [line for line in axes.lines if line.get_linestyle() != "None"]
        paths = [line.get_transform().transform(line.get_path().vertices) for line in drawn]
        self._along = np.concatenate([np.empty((0, 2)), *(_along(path) for path in paths)])
        legend = axes.get_legend()
        boxes = [Bbox.from_extents(*(point - MARKER), *(point + MARKER)) for point in self._points]
        self.taken = boxes if legend is None else [*boxes, legend.get_window_extent()]

    def cost(self, box: Bbox, own: tuple[float, float]) -> float:
        """The cost, px^2, of a label that covers `box` and belongs to the point `own`."""
        hidden = sum(_shared(box, other) for other in self.taken)
        beyond = _area(box) - _shared(box, self._inside)
        crossed = np.all((self._along > box.min) & (self._along < box.max), axis=1).sum()
        at = self._axes.transData.transform(own)
        others = self._points[np.abs(self._points - at).max(axis=1) > 1]
        strange = _distance(others, box).min(initial=np.inf) < _distance(at[None], box)[0]
        return hidden + beyond + ON_A_LINE * crossed + STRANGE * strange


def _box(label: Annotation, side: tuple[float, float, str], canvas: FigureCanvasAgg) -> Bbox:
    """Move the label to `side`; returns its bounding box, px."""
    right, up, edge = side
    label.xyann = (right, up)
    label.set_horizontalalignment(edge)  # type: ignore[arg-type]
    return label.get_window_extent(canvas.get_renderer())


def _along(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2) points about 1 px apart along a polyline (M, 2)."""
    pieces = [np.linspace(a, b, 1 + int(np.hypot(*(b - a)))) for a, b in pairwise(path)]
    return np.concatenate([path, *pieces])


def _shared(one: Bbox, other: Bbox) -> float:
    common = Bbox.intersection(one, other)
    return 0.0 if common is None else _area(common)


def _area(box: Bbox) -> float:
    return float(box.width * box.height)


def _distance(points: NDArray[np.float64], box: Bbox) -> NDArray[np.float64]:
    """(N,) distance, px, of points (N, 2) to the box; 0 inside."""
    away = np.maximum(np.maximum(box.min - points, points - box.max), 0)
    return np.hypot(away[:, 0], away[:, 1])
