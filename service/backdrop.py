"""A coarse sheet behind the depths of each photograph and around it: gaps and what lies beyond show colour, no hole.

What it shows is a guess: the colour of the farthest surface nearby. The network has such a sheet too, behind depths
that have moved since; this one takes its place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .gaussians import Gaussians, joined
from .harmonics import C0
from .images import FittedView
from .rotations import quaternion_from_matrix

F64 = NDArray[np.float64]

CELL = 8  # px
MARGIN = (1, 1)  # width in cells of what still belongs to the sheet, beyond the border
RINGS = (2, 4, 8)  # and of what stands around it: 128 px to each side in all
PUSH_BACK = 0.93  # on inverse depth: 7 % farther, so that the sheet never hides the surface that it backs
FAR_PREFERENCE = 12.0  # weight e^-12 of a pixel's colour at half the distance
NEIGHBOUR = 0.7  # cells: standard deviation of the weight of the cells around, whose colours count as well
SPREAD = 0.6  # standard deviation, of a cell
FLATNESS = 0.1  # thickness over spread
OPACITY = 0.9
KEPT = 0.5  # share of a cell's pixels that a mask must keep


def backdrop(views: Sequence[FittedView], depths: F64, coefficients: int) -> tuple[Gaussians, int]:
    """Flat Gaussians behind and, from the returned index on, around the photographs; one for each cell.

    `depths` (V, H, W) are z-depths in the cameras' units, H and W multiples of CELL; of the `coefficients` harmonics
    all but the first are 0. A cell stands behind the farthest depth of the 3 x 3 cells about it and has the mean colour
    of what lies as far away there. Beyond the border a cell has the colour of the nearest one, and its depth; on a ring
    it stands behind all cells that are as near to that one as the ring reaches out. Where a mask keeps less than KEPT
    of the cell none stands, and about a masked photograph no ring: what its mask leaves out is not to be seen.
    """
    sets = [_of_view(view, 1 / depth, coefficients) for view, depth in zip(views, depths, strict=True)]
    behind, around = (joined(*parts) for parts in zip(*sets, strict=True))
    return joined(behind, around), len(behind)


def _of_view(view: FittedView, inverse: F64, coefficients: int) -> tuple[Gaussians, Gaussians]:
    """Behind and around one view."""
    camera = view.camera
    mask = np.ones(inverse.shape, np.bool_) if view.mask is None else view.mask
    cells = _blocks(np.where(mask, inverse, np.inf)).min(axis=(1, 3))
    far = _least_within(cells, 1)
    colours = _colours(view, inverse, far)
    kept = _blocks(mask).mean(axis=(1, 3)) >= KEPT
    grids = [_grid(count) for count in far.shape]
    widths, middles, nearest, outside = (np.meshgrid(*axes, indexing="ij") for axes in zip(*grids, strict=True))
    row, column = nearest
    kept, out = kept[row, column], np.maximum(*outside)
    least = far[row, column]
    for distance in np.unique(out[out > sum(MARGIN)]):
        least = np.where(out == distance, _least_within(cells, distance)[row, column], least)

    def chosen(which: NDArray[np.bool_]) -> Gaussians:
        z = 1 / (PUSH_BACK * least[which])
        y, x = (CELL * axis[which] for axis in middles)
        high, wide = (SPREAD * CELL * axis[which] * z for axis in widths)
        size = np.minimum(np.stack([wide / camera.fx, high / camera.fy], axis=1), np.finfo(np.float32).max)
        harmonics = np.zeros((len(z), coefficients, 3))
        harmonics[:, 0] = (colours[row, column][which] - 0.5) / C0
        return Gaussians.make(
            camera.unproject(np.stack([x, y], axis=1), z),
            np.column_stack([size, FLATNESS * size.min(axis=1)]),
            np.tile(quaternion_from_matrix(camera.rotation), (len(z), 1)),
            np.full(len(z), OPACITY),
            harmonics,
        )

    return chosen(kept & (out <= sum(MARGIN))), chosen(kept & (out > sum(MARGIN)) & (view.mask is None))


def _grid(count: int) -> tuple[F64, F64, NDArray[np.intp], NDArray[np.intp]]:
    """Along one side of `count` cells: widths and middles of all with those beyond both ends, in cells; the nearest
    cell of the photograph; and how far the outer edge lies beyond the border, 0 inside."""
    beyond = np.array([*MARGIN, *RINGS])
    widths = np.concatenate([beyond[::-1], np.ones(count, int), beyond])
    edges = np.concatenate([[0], np.cumsum(widths)]) - beyond.sum()
    middles = (edges[1:] + edges[:-1]) / 2
    nearest = np.clip(np.floor(middles), 0, count - 1).astype(np.intp)
    return widths.astype(np.float64), middles, nearest, np.maximum(np.maximum(-edges[:-1], edges[1:] - count), 0)


def _colours(view: FittedView, inverse: F64, far: F64) -> F64:
    """(rows, columns, 3) mean colour about each cell of what lies as far away as `far` (rows, columns) says."""
    weighed, weights = np.zeros((3, *far.shape)), np.zeros(far.shape)
    kept = np.ones(inverse.shape) if view.mask is None else view.mask.astype(np.float64)
    edge = np.pad(view.image.astype(np.float64), ((0, 0), (CELL, CELL), (CELL, CELL)), mode="edge")
    depth, kept = np.pad(inverse, CELL, mode="edge"), np.pad(kept, CELL, mode="edge")
    here = np.where(np.isfinite(far), far, 1.0).repeat(CELL, axis=0).repeat(CELL, axis=1)
    height, width = inverse.shape
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            top, left = CELL * (1 + down), CELL * (1 + right)
            window = np.s_[top : top + height, left : left + width]
            near = np.exp(-(down**2 + right**2) / (2 * NEIGHBOUR**2))
            weight = near * kept[window] * np.exp(-FAR_PREFERENCE * np.abs(depth[window] / here - 1))
            weighed += _blocks(edge[(slice(None), *window)] * weight).sum(axis=(-3, -1))
            weights += _blocks(weight).sum(axis=(-3, -1))
    return np.moveaxis(weighed / np.maximum(weights, np.finfo(np.float64).tiny), 0, -1)


def _blocks(values: NDArray) -> NDArray:
    """(..., H, W) -> (..., rows, CELL, columns, CELL)."""
    height, width = values.shape[-2:]
    return values.reshape(*values.shape[:-2], height // CELL, CELL, width // CELL, CELL)


def _least_within(cells: F64, distance: int) -> F64:
    """(rows, columns) least value of the cells up to `distance` away in both directions."""
    side = 2 * distance + 1
    padded = np.pad(cells, distance, constant_values=np.inf)
    return np.lib.stride_tricks.sliding_window_view(padded, (side, side)).min(axis=(-2, -1))
