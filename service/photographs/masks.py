"""Applying masks: whole patches are skipped by the network, single Gaussians dropped after it, all of it counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..cameras.rotations import rotated
from ..errors import ImageError
from .images import FittedView

if TYPE_CHECKING:
    from ..cameras.world_frame import WorldFrame

TRANSPARENT = "opacity is 0"
MASKED = "its pixel is masked"
UNSEEN = "behind masked pixels only"
REPLACED = "stood behind depths that have moved"
FADED = "faded until nothing of it is drawn"


def check_kept(view: FittedView, index: int) -> None:
    """Raises `ImageError` for a photograph whose mask keeps no pixel of what the scene has of it."""
    if view.mask is None or view.mask.any():
        return
    height, width = view.mask.shape
    raise ImageError(
        f"the mask keeps 0 of {width} x {height} px, the middle {view.kept_share:.0%} of the photograph",
        field="images",
        index=index,
        cure="crop the photograph about what the mask keeps, and take the crop's corner off cx and cy",
    )


def patch_mask(views: Sequence[FittedView], rows: int, columns: int) -> NDArray[np.bool_]:
    """(V, P) which of `rows` x `columns` equal patches of each view have the centre of a kept pixel, row by row."""
    found = []
    for view in views:
        height, width = view.image.shape[1:]
        down, across = (
            np.searchsorted((np.arange(count) + 0.5) * patches / count, np.arange(patches))
            for count, patches in ((height, rows), (width, columns))
        )  # the first pixel of each patch
        found.append(np.logical_or.reduceat(np.logical_or.reduceat(view.kept, down, 0), across, 1).ravel())
    return np.stack(found)


def kept_rows(
    outputs: Mapping[str, NDArray], views: Sequence[FittedView], frame: WorldFrame
) -> tuple[NDArray[np.intp], dict[str, int]]:
    """Indices of the network's Gaussians that stay in the scene, ascending, and the number of dropped ones by reason.

    The first V * H * W Gaussians belong to the pixels in order; those of masked pixels are dropped. The rest form the
    backing layer; if there are masks, they stay only where they project to a kept pixel of at least one view.
    """
    opaque = outputs["opacities"] > 0
    dropped = {TRANSPARENT: int((~opaque).sum())}
    keep = opaque.copy()
    if any(view.mask is not None for view in views):
        pixel = np.concatenate([view.kept.ravel() for view in views])
        count = len(pixel)
        keep[:count] &= pixel
        dropped[MASKED] = int((opaque[:count] & ~pixel).sum())
        points = frame.origin + rotated(frame.rotation, outputs["means"][count:]) * frame.unit
        seen = np.zeros(len(points), dtype=np.bool_)
        for view in views:
            seen |= _on_kept_pixel(view, points)
        dropped[UNSEEN] = int((opaque[count:] & ~seen).sum())
        keep[count:] &= seen
    return np.flatnonzero(keep), {reason: count for reason, count in dropped.items() if count}


def _on_kept_pixel(view: FittedView, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether the world points (N, 3) project to a pixel that the mask keeps."""
    pixels, z = view.camera.project(points)
    inside = view.camera.shows(pixels, z)
    column, row = np.where(inside[:, None], pixels, 0.0).astype(np.intp).T
    return inside & view.kept[row, column]
