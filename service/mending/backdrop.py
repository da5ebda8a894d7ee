"""The backdrop: coarse sheets of flat Gaussians behind and around each photograph, so that disocclusions show no hole.

Their colour is a guess, that of the farthest surface nearby. They replace the network's own backing layer, which stands
behind depths that have moved since.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras.rotations import quaternion_from_matrix
from ..gaussians import Gaussians, joined
from ..harmonics import C0
from ..photographs.images import FittedView
from .outlines import clear_of_masks

F64 = NDArray[np.float64]

CELL = 8  # px
MARGIN = (1, 1)  # widths in cells of the sheet's rows and columns beyond the border
# Widths in cells of the rings around it; with the margin 512 px to each side. Flat Gaussians of wider cells would reach
# back into the photograph.
RINGS = (2, 4, 8, 8, 8, 16, 16)
BEYOND = 4  # radius in cells of the neighbourhood whose farthest depth the second sheet takes
DEEPER = 0.85  # a cell of the second sheet needs less than this share of the first one's inverse depth
PUSH_BACK = 0.93  # on inverse depth: 7 % farther, so that a sheet never occludes what it stands behind
FAR_PREFERENCE = 12.0  # weight e^-12 of a pixel's colour at half the distance
NEIGHBOUR = 0.7  # cells: standard deviation of the weights of neighbouring cells' colours
SPREAD = 0.6  # standard deviation, of a cell
FLATNESS = 0.1  # thickness over spread
OPACITY = 0.9
KEPT = 0.5  # share of a cell's pixels that a mask must keep


def backdrop(views: Sequence[FittedView], depths: F64, coefficients: int) -> tuple[Gaussians, int]:
    """Flat Gaussians behind and, from the returned index on, around the photographs; none, one or two per cell.

    `depths` (V, H, W) are z-depths in the cameras' units, H and W multiples of CELL; of the `coefficients` harmonics
    all but the first are 0. The first sheet: a cell stands behind the farthest depth of the 3 x 3 cells around it, in
    the mean colour of the pixels of about that depth there. The second sheet: where the first one, within BEYOND cells,
    is at less than DEEPER of this inverse depth, a cell stands behind the farthest of it, in its colour. Cells of the
    margin take depth and colour of the nearest cell; those of a ring take its colour, and stand behind all cells within
    the ring's outer distance of it. No cell stands where a mask keeps less than KEPT of it, nor where it would reach
    into what a mask leaves out (`clear_of_masks`), and a masked photograph has neither second sheet nor rings: what its
    mask leaves out must stay invisible.
    """
    sets = [_of_view(view, 1 / depth, coefficients) for view, depth in zip(views, depths, strict=True)]
    owner = np.repeat(np.arange(len(sets)), [len(own) for own, _ in sets])
    behind, around = (joined(*parts) for parts in zip(*sets, strict=True))
    behind = behind[clear_of_masks(behind.means.astype(np.float64), owner, views, depths)]
    return joined(behind, around), len(behind)


def _of_view(view: FittedView, inverse: F64, coefficients: int) -> tuple[Gaussians, Gaussians]:
    """The Gaussians behind and those around one view, from its inverse depths (H, W)."""
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

    def flat_gaussians(which: NDArray[np.bool_], inverse_depths: F64, rgb: F64) -> Gaussians:
        """One Gaussian per cell in `which`, with its inverse depth and colour."""
        z = 1 / inverse_depths[which]
        y, x = (CELL * axis[which] for axis in middles)
        high, wide = (SPREAD * CELL * axis[which] * z for axis in widths)
        size = np.minimum(np.stack([wide / camera.fx, high / camera.fy], axis=1), np.finfo(np.float32).max)
        harmonics = np.zeros((len(z), coefficients, 3))
        harmonics[:, 0] = (rgb[which] - 0.5) / C0
        return Gaussians.make(
            camera.unproject(np.stack([x, y], axis=1), z),
            np.column_stack([size, FLATNESS * size.min(axis=1)]),
            np.tile(quaternion_from_matrix(camera.rotation), (len(z), 1)),
            np.full(len(z), OPACITY),
            harmonics,
        )

    shown, whole = colours[row, column], view.mask is None
    behind = flat_gaussians(kept & (out <= sum(MARGIN)), PUSH_BACK * least, shown)
    farther, colours = _farther(far, colours)
    deeper = kept & (out == 0) & (farther < DEEPER * far)[row, column] & whole
    second = flat_gaussians(deeper, PUSH_BACK**2 * farther[row, column], colours[row, column])
    around = flat_gaussians(kept & (out > sum(MARGIN)) & whole, PUSH_BACK * least, shown)
    return joined(behind, second), around


def _grid(count: int) -> tuple[F64, F64, NDArray[np.intp], NDArray[np.intp]]:
    """Along one axis of `count` cells, for these and the margin and rings beyond both ends: widths and centres in
    cells; index of the nearest cell of the photograph; distance of the outer edge from the border in cells, 0
    inside."""
    beyond = np.array([*MARGIN, *RINGS])
    widths = np.concatenate([beyond[::-1], np.ones(count, int), beyond])
    edges = np.concatenate([[0], np.cumsum(widths)]) - beyond.sum()
    middles = (edges[1:] + edges[:-1]) / 2
    nearest = np.clip(np.floor(middles), 0, count - 1).astype(np.intp)
    return widths.astype(np.float64), middles, nearest, np.maximum(np.maximum(-edges[:-1], edges[1:] - count), 0)


def _colours(view: FittedView, inverse: F64, far: F64) -> F64:
    """(rows, columns, 3) weighted mean colour around each cell of the pixels near the inverse depth `far` (rows,
    columns)."""
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
    """(rows, columns) the least of `far` within BEYOND cells, and (rows, columns, 3) the weighted mean colour of the
    cells near it."""
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
    """(rows, columns) least value within `distance` cells along both axes."""
    padded = np.pad(cells, distance, mode="edge")
    for axis in (0, 1):  # one after the other: as many comparisons as a window has rows and columns, not cells
        padded = np.lib.stride_tricks.sliding_window_view(padded, 2 * distance + 1, axis=axis).min(axis=-1)
    return padded


def _about(cells: F64, distance: int) -> F64:
    """(rows, columns, ..., side, side) windows of the `cells` (rows, columns, ...) within `distance` along both axes,
    border cells repeated outwards."""
    sides = (distance, distance)
    padded = np.pad(cells, (sides, sides, *((0, 0),) * (cells.ndim - 2)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (2 * distance + 1,) * 2, axis=(0, 1))
