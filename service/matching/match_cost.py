"""How much photographs differ at the places where one view's depths put its pixels in another one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..photographs.images import FittedView
from .correspondence import Seen, seen_by
from .guided_filter import GuidedFilter
from .plane_kernels import compare_planes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRADIENT = 6.0  # weight of a difference of grey slopes (per px) beside one of a colour's channel
LIMIT = 0.25  # of the mean difference, from which two places are as different as can be
SEEN = 0.05  # share of a window that must be seen for its costs to count in full
GAIN = 0.9  # of the cost of the depth as it is; what gains less stays
NOTHING = 1e-4  # of a difference, a fortieth of an 8-bit level: what gains less stays as well


def features(view: FittedView) -> F32:
    """(H, W, 5) the colours and the slopes of grey across and down, 0 at the border and beside masked pixels."""
    grey = view.image.mean(axis=0)
    kept = view.kept
    slopes = np.zeros((2, *grey.shape), np.float32)
    slopes[0, :, 1:-1] = (kept[:, 2:] & kept[:, :-2]) * (grey[:, 2:] - grey[:, :-2]) / 2
    slopes[1, 1:-1] = (kept[2:] & kept[:-2]) * (grey[2:] - grey[:-2]) / 2
    return np.ascontiguousarray(np.concatenate([view.image, np.float32(GRADIENT) * slopes]).transpose(1, 2, 0))


def difference(view: FittedView, own: F32, depth: F64, other: FittedView, others: F32) -> F64:
    """(H, W) mean absolute difference of the `features` of both views at z-depths (H, W) in the cameras' units; LIMIT
    at most, and LIMIT where the other view does not see the point."""
    return difference_there(own, seen_by(view, depth, other), others)


def difference_there(own: F32, seen: Seen, others: F32) -> F64:
    """The same at the places where the pixels are `seen` in the other view."""
    cost = np.empty(seen.z.shape)
    compare_planes(own, others, seen.column, seen.row, seen.where.view(np.uint8), LIMIT, cost)
    return cost


class Gathering:
    """Gathers costs within the surfaces of a view (on cost volumes: Hosni et al. 2011), over what is known of them."""

    def __init__(self, view: FittedView, known: Mask) -> None:
        """`known` (H, W): elsewhere costs are 0."""
        self.filter = GuidedFilter(view.image.mean(axis=0, dtype=np.float64))
        self.share = np.maximum(self.filter.of(known.astype(np.float64)), SEEN)

    def of(self, cost: F64) -> F64:
        """(H, W) of a depth's `cost` (H, W)."""
        found = self.filter.of(cost)
        found /= self.share
        return np.maximum(found, 0, out=found)  # the filter undershoots
