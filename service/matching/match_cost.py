"""Matching costs between views at given depths, and their edge-aware aggregation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..photographs.images import FittedView
from .correspondence import Reprojection, reprojected
from .guided_filter import GuidedFilter
from .reprojection_kernels import compare_pixels

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRADIENT = 6.0  # weight of a difference of grey gradients (per px) relative to one of a colour channel
LIMIT = 0.25  # at which the mean difference is truncated
SEEN = 0.05  # least share of a window by which an aggregated cost is normalised
GAIN = 0.9  # a depth replaces the current one only if its cost is below this share of the current cost,
NOTHING = 1e-4  # and lower by more than this: a fortieth of an 8-bit level


def features(view: FittedView) -> F32:
    """(H, W, 5) RGB and the weighted horizontal and vertical gradient of grey, 0 at the border and next to masked
    pixels."""
    grey = view.image.mean(axis=0)
    kept = view.kept
    slopes = np.zeros((2, *grey.shape), np.float32)
    slopes[0, :, 1:-1] = (kept[:, 2:] & kept[:, :-2]) * (grey[:, 2:] - grey[:, :-2]) / 2
    slopes[1, 1:-1] = (kept[2:] & kept[:-2]) * (grey[2:] - grey[:-2]) / 2
    return np.ascontiguousarray(np.concatenate([view.image, np.float32(GRADIENT) * slopes]).transpose(1, 2, 0))


def difference(view: FittedView, own: F32, depth: F64, other: FittedView, others: F32) -> F64:
    """(H, W) mean absolute difference of the `features` of both views at z-depths `depth` (H, W) in the cameras' units,
    truncated at LIMIT, and LIMIT where the other view does not see the point."""
    return difference_there(own, reprojected(view, depth, other), others)


def difference_there(own: F32, seen: Reprojection, others: F32) -> F64:
    """As `difference`, for pixels that were reprojected already."""
    cost = np.empty(seen.z.shape)
    compare_pixels(own, others, seen.column, seen.row, seen.where.view(np.uint8), LIMIT, cost)
    return cost


class CostAggregation:
    """Aggregates costs by a guided filter (cost-volume filtering, Hosni et al. 2011), normalised over known pixels."""

    def __init__(self, view: FittedView, known: Mask) -> None:
        """`known` (H, W): pixels that have a cost; at all others it must be 0."""
        self.filter = GuidedFilter(view.grey)
        self.share = np.maximum(self.filter.of(known.astype(np.float64)), SEEN)

    def of(self, cost: F64) -> F64:
        """(H, W) aggregated from the `cost` (H, W) of one depth hypothesis."""
        found = self.filter.of(cost)
        found /= self.share
        return np.maximum(found, 0, out=found)  # a guided filter can undershoot
