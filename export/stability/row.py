"""A row of the stability table, and the comparison of two pictures away from the splatter's cut-offs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gapmes.service.cameras.camera import Camera
from gapmes.service.gaussians import Gaussians
from gapmes.service.splat import Definition, Render, render, render_reference

MOST_EDGES = 0.05
EDGE = 1e-5  # of a cut: nearer pixels may fall on either side of it in another precision


@dataclass(frozen=True)
class Row:
    """The largest error of one case over a sweep, in `unit`; `naive` is that of plain float32, None without one."""

    case: str
    what: str
    sweep: str
    reference: str
    unit: str
    worst: float
    tolerance: float
    naive: float | None = None
    naive_is: str = ""

    @property
    def passed(self) -> bool:
        return bool(self.worst <= self.tolerance)


def larger(*errors: float) -> float:
    """The largest error, infinite where one is NaN: `max` would pass over it, depending on the order."""
    return math.inf if any(map(math.isnan, errors)) else max(errors)


def against_reference(gaussians: Gaussians, camera: Camera, rule: Definition | None = None) -> tuple[float, Render]:
    """The largest error of colour and opacity away from cut-offs, and the float64 picture. Raises `ValueError` where
    more than MOST_EDGES of the pixels lie on one."""
    rule = rule or Definition()
    ours, true = render(gaussians, camera, definition=rule), render_reference(gaussians, camera, definition=rule)
    edge = edges(gaussians, camera, rule, true)
    error = np.maximum(np.abs(ours.rgb - true.rgb).max(axis=2), np.abs(ours.alpha - true.alpha))
    if edge.mean() > MOST_EDGES:
        raise ValueError(f"{edge.mean():.0%} of the pixels lie on a cut, nothing is left to compare")
    return float(error[~edge].max()), true


def edges(gaussians: Gaussians, camera: Camera, rule: Definition, true: Render) -> NDArray[np.bool_]:
    """(H, W) mask of pixels whose float64 opacity changes when a cut-off changes by the share `EDGE`."""
    found = np.zeros(true.alpha.shape, bool)
    for share in (1 - EDGE, 1 + EDGE):
        for other in (replace(rule, alpha_min=rule.alpha_min * share), replace(rule, stop=rule.stop * share)):
            found |= render_reference(gaussians, camera, definition=other).alpha != true.alpha
    return found
