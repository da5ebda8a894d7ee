"""Agreement of routes between two runtimes: patches that differ, undecided ones, and the outputs they affect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gapmes.model.backing import CELL, MARGIN
from gapmes.model.config import PIXELS_PER_PATCH

# A route may legitimately differ where the deciding logits are closer than float32 can tell apart, as a share of the
# largest: some 300 roundings. The service tells ambiguous routes by a wider margin, which covers two runtimes.
AMBIGUOUS_GAP = 2e-5
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class RouteAgreement:
    """Counts of patches whose experts or leading task differ; unambiguous where the logits are clearly apart."""

    patches: int
    flipped: int
    flipped_unambiguous: int


def ambiguous(logits: NDArray, deciding: int) -> Bools:
    """(M,) mask of patches where one of the first `deciding` gaps between sorted logits (M, c) is at most AMBIGUOUS_GAP
    of the largest magnitude."""
    ordered = -np.sort(-logits, axis=-1)
    gaps = (ordered[:, :-1] - ordered[:, 1:])[:, :deciding].min(axis=-1, initial=np.inf)
    return gaps <= AMBIGUOUS_GAP * np.abs(logits).max(-1)


def flipped_patches(values: Mapping[str, NDArray], reference: Mapping[str, NDArray], kept: Bools) -> Bools:
    """(V, P) mask of kept patches with other experts or another leading task."""
    differs = np.zeros(kept.shape, dtype=np.bool_)
    if "expert_index" in reference:
        differs |= (values["expert_index"] != reference["expert_index"]).any(-1)
    if "task_weight" in reference:
        differs |= values["task_weight"].argmax(-1) != reference["task_weight"].argmax(-1)
    return differs & kept


def agreement(flipped: Bools, undecided: Bools, kept: Bools) -> RouteAgreement:
    """Counts over all patches; `undecided` (V, P) marks those where rounding may decide."""
    return RouteAgreement(int(kept.sum()), int(flipped.sum()), int((flipped & ~undecided).sum()))


def untouched(flipped: Bools, height: int, width: int, gaussians: int) -> dict[str, Bools]:
    """Masks of the elements that no flipped patch affects, by kind of output: "patch", "pixel", "gaussian".

    A patch affects its own pixels, those around it through 3x3 convolutions, and the cells of the backing layer behind
    them: a margin of one patch on every side covers all of these.
    """
    views = len(flipped)
    grid = flipped.reshape(views, height // PIXELS_PER_PATCH, width // PIXELS_PER_PATCH)
    padded = np.pad(grid, ((0, 0), (1, 1), (1, 1)))
    rows, columns = grid.shape[1:]
    reached = np.zeros_like(grid)
    for dy in range(3):
        for dx in range(3):
            reached |= padded[:, dy : dy + rows, dx : dx + columns]
    pixels = reached.repeat(PIXELS_PER_PATCH, 1).repeat(PIXELS_PER_PATCH, 2)
    gaussian = pixels.reshape(-1)
    if gaussians > gaussian.size:
        cells = pixels[:, ::CELL, ::CELL]
        cells = np.pad(cells, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)), mode="edge")
        gaussian = np.concatenate([gaussian, cells.reshape(-1)])
    return {"patch": ~flipped, "pixel": ~pixels, "gaussian": ~gaussian}
