"""Coarse sheets behind the depths of each photograph and around it: gaps and what lies beyond show colour, no hole.

What they show is a guess: the colour of the farthest surface nearby. The network has such a sheet too, behind depths
that have moved since; these take its place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.rotations import quaternion_from_matrix
from ..gaussians import Gaussians, joined
from ..harmonics import C0
from ..photographs.images import FittedView

F64 = NDArray[np.float64]

CELL = 8  # px
MARGIN = (1, 1)  # width in cells of what still belongs to the sheet, beyond the border
RINGS = (2, 4, 8)  # and of what stands around it: 128 px to each side in all
BEYOND = 4  # cells to each side of one, of whose sheet the second one has the farthest depth
DEEPER = 0.85  # of the sheet's own inverse depth: where the second one has less it stands
PUSH_BACK = 0.93  # on inverse depth: 7 % farther, so that a sheet never hides the surface, or the sheet, that it backs
FAR_PREFERENCE = 12.0  # weight e^-12 of a pixel's colour at half the distance
NEIGHBOUR = 0.7  # cells: standard deviation of the weight of the cells around, whose colours count as well
SPREAD = 0.6  # standard deviation, of a cell
FLATNESS = 0.1  # thickness over spread
OPACITY = 0.9
KEPT = 0.5  # share of a cell's pixels that a mask must keep


def backdrop(views: Sequence[FittedView], depths: F64, coefficients: int) -> tuple[Gaussians, int]:
    """Flat Gaussians behind and, from the returned index on, around the photographs; none, one or two for each cell.

    `depths` (V, H, W) are z-depths in the cameras' units, H and W multiples of CELL; of the `coefficients` harmonics
    all but the first are 0. A cell stands behind the farthest depth of the 3 x 3 cells about it and has the mean colour
    of what lies as far away there. Where the sheet of BEYOND cells more to each side is farther somewhere, at less than
    DEEPER of this inverse depth, a second one stands behind that, in its colour. Beyond the border a cell has the
    colour of the nearest one, and its depth; on a ring it stands behind all cells that are as near to that one as the
    ring reaches out. Where a mask keeps less than KEPT of the cell none stands, and a masked photograph has no second
    one and no ring: what its mask leaves out is not to be seen.
    """
    sets = [_of_view(view, 1 / depth, coefficients) for view, depth in zip(views, depths, strict=True)]
    behind, around = (joined(*parts) for parts in zip(*sets, strict=True))
    return joined(behind, around), len(behind)


def _of_view(view: FittedView, inverse: F64, coefficients: int) -> tuple[Gaussians, Gaussians]:
    """Behind and around one view."""
    camera = view.camera
    mask = view.kept
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

    def chosen(which: NDArray[np.bool_], inverse: F64, colours: F64) -> Gaussians:
        """One for each that is chosen, of its inverse depth and its colour."""
        z = 1 / inverse[which]
        y, x = (CELL * axis[which] for axis in middles)
        high, wide = (SPREAD * CELL * axis[which] * z for axis in widths)
        size = np.minimum(np.stack([wide / camera.fx, high / camera.fy], axis=1), np.finfo(np.float32).max)
        harmonics = np.zeros((len(z), coefficients, 3))
        harmonics[:, 0] = (colours[which] - 0.5) / C0
        return Gaussians.make(
            camera.unproject(np.stack([x, y], axis=1), z),
            np.column_stack([size, FLATNESS * size.min(axis=1)]),
            np.tile(quaternion_from_matrix(camera.rotation), (len(z), 1)),
            np.full(len(z), OPACITY),
            harmonics,
        )

    shown, whole = colours[row, column], view.mask is None
    behind = chosen(kept & (out <= sum(MARGIN)), PUSH_BACK * least, shown)
    farther, colours = _farther(far, colours)
    deeper = kept & (out == 0) & (farther < DEEPER * far)[row, column] & whole
    second = chosen(deeper, PUSH_BACK**2 * farther[row, column], colours[row, column])
    return joined(behind, second), chosen(kept & (out > sum(MARGIN)) & whole, PUSH_BACK * least, shown)


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
    kept = view.kept.astype(np.float64)
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


def _farther(far: F64, colours: F64) -> tuple[F64, F64]:
    """(rows, columns) least of `far` within BEYOND cells, and (rows, columns, 3) mean of the colours of what has it."""
    depths = _about(far, BEYOND)
    least = depths.min(axis=(-2, -1))
    here = np.where(np.isfinite(least), least, 1.0)[..., None, None]
    weights = np.exp(-FAR_PREFERENCE * np.abs(depths / here - 1))
    weighed = np.einsum("rcij,rckij->rck", weights, _about(colours, BEYOND))
    return least, weighed / np.maximum(weights.sum(axis=(-2, -1)), np.finfo(np.float64).tiny)[..., None]


def _blocks(values: NDArray) -> NDArray:
    """(..., H, W) -> (..., rows, CELL, columns, CELL)."""
    height, width = values.shape[-2:]
    return values.reshape(*values.shape[:-2], height // CELL, CELL, width // CELL, CELL)


def _least_within(cells: F64, distance: int) -> F64:
    """(rows, columns) least value of the cells up to `distance` away in both directions."""
    return _about(cells, distance).min(axis=(-2, -1))


def _about(cells: F64, distance: int) -> F64:
    """(rows, columns, ..., side, side) the cells (rows, columns, ...) up to `distance` away in both directions, beyond
    the border the last ones."""
    sides = (distance, distance)
    padded = np.pad(cells, (sides, sides, *((0, 0),) * (cells.ndim - 2)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (2 * distance + 1,) * 2, axis=(0, 1))
