"""The stages after the network: refine depths, add a backdrop, fit opacities and colours to the photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.world_frame import WorldFrame
from ..formats.ply_write import as_stored
from ..gaussians import Gaussians, joined
from ..leaving_out.stride import thinned
from ..matching.confirmed import confirmed
from ..network.contract import GAUSSIAN_OUTPUTS
from ..network.engine import Arrays
from ..photographs.images import FittedView, PackedView
from ..photographs.masks import FADED, REPLACED, kept_rows
from ..process.allocator import freed_blocks_reused
from ..viewpoints.scene_views import SceneViews
from .anchors import anchors
from .backdrop import backdrop
from .blank import blank_held, blank_moved
from .choice.chosen import chosen
from .choice.network import shipped_choice
from .continued import continued
from .continued_finely import continued_finely
from .fading import Fading, faded
from .refined import refined
from .searched import searched

MOVED = frozenset(GAUSSIAN_OUTPUTS) - {"opacities"}  # outputs that are no longer needed once `placed`
CONTINUED_VIEWS = 3  # with more, nearly everything is confirmed, and plane continuation makes it worse
ANCHORED_VIEWS = 3  # with more, photographs contradict floaters, and anchors would fade unconfirmed surfaces
SMOOTHING = 0.1  # px^2 in the input view, added to all three variances


@dataclass(frozen=True, eq=False)
class Placed:
    """Gaussians in the caller's world, and which pixel each belongs to."""

    gaussians: Gaussians  # positions rounded as the .ply stores them
    rows: NDArray[np.intp]  # (N,) < V * H * W: index of its pixel; from there on Gaussians behind the scene,
    around: int  # and from this row on those around the photographs
    depths: NDArray[np.float64]  # (V, H, W) z-depths of the pixels, in the cameras' units
    dropped: dict[str, int]  # of the network's Gaussians, by reason
    added: int  # that are not the network's

    @property
    def of_pixel(self) -> NDArray[np.bool_]:
        """(N,) whether each belongs to a pixel."""
        return self.rows < self.depths.size

    @property
    def owner(self) -> NDArray[np.intp]:
        """(N,) index of the view whose pixel each belongs to, V for none."""
        return np.minimum(self.rows // self.depths[0].size, len(self.depths))


@dataclass(frozen=True, eq=False)
class Unpruned:
    """A scene before anything of it is left out: what the network and the stages after it have made of photographs."""

    outputs: Arrays  # the network's, but for MOVED ones
    patch_mask: NDArray[np.bool_]  # (V, P) its patches in which the photographs have a kept pixel
    placed: Placed
    fading: Fading  # of the `placed` Gaussians

    @property
    def gaussians(self) -> Gaussians:
        """Those that are still drawn."""
        return self.fading.gaussians[~self.fading.gone]

    @property
    def of_pixel(self) -> NDArray[np.bool_]:
        """(N,) whether each of these belongs to a pixel."""
        return self.placed.of_pixel[~self.fading.gone]

    @property
    def dropped(self) -> dict[str, int]:
        """Number of Gaussians that are not among them, by reason."""
        gone = int(self.fading.gone.sum())
        return {**self.placed.dropped, FADED: gone} if gone else self.placed.dropped


@freed_blocks_reused()
def at_mended_depths(
    outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], far: float, threads: int | None = None
) -> Arrays:
    """The network's outputs with every pixel's Gaussian moved to a refined depth: `matched_depths`, for two views the
    choice network among candidates (`choice/`), then blank backdrops to `far`, the z-depth at which the scene ends, in
    the caller's units. `threads` does not change the bits."""
    network = frame.depths(outputs)
    matched, depths = matched_depths(views, network, threads)
    if len(views) == 2:  # of more, others confirm most of what is seen, and photographs lose by it
        depths = chosen(views, depths, (network, matched), shipped_choice())
    return frame.at_depths(outputs, [view.camera for view in views], blank_moved(views, depths, far))


def matched_depths(
    views: Sequence[FittedView], depths: NDArray[np.float64], threads: int | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(V, H, W) z-depths from the network's `depths` (V, H, W): after matching, and after plane continuation as
    well."""
    count = len(views)
    if count == 2:  # of more, others confirm most of what is seen, and planes gain nothing before the search
        depths = continued(views, depths)
    matched = refined(views, searched(views, refined(views, depths), threads))
    if count == 2:
        return matched, continued_finely(views, matched)
    return matched, continued(views, matched) if count <= CONTINUED_VIEWS else matched


@freed_blocks_reused()
def at_finer_depths(outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], far: float) -> Arrays:
    """As `at_mended_depths`, for outputs that were mended and then upsampled (`detail.py`): local refinement alone, for
    two views after plane continuation; blank backdrops stay at `far`."""
    before = frame.depths(outputs)
    depths = refined(views, continued(views, before) if len(views) == 2 else before)
    return frame.at_depths(outputs, [view.camera for view in views], blank_held(views, before, depths, far))


@freed_blocks_reused()
def placed(
    outputs: Arrays,
    frame: WorldFrame,
    views: Sequence[FittedView],
    *,
    stride: int = 1,
    moved: bool,
    coarse: Sequence[FittedView] | None = None,
) -> Placed:
    """The Gaussians of the scene in the caller's world: those of the network that masks and opacity keep, one per
    square of `stride` px. If depths have `moved`, they are smoothed, and a backdrop made from the new depths replaces
    the network's own. If `views` have more pixels than the network saw, `coarse` are the views at its size: they set
    the width of the backdrop's cells, each of which stands behind the farthest of the finer depths in it."""
    rows, dropped = kept_rows(outputs, views, frame)
    depths = frame.depths(outputs)
    thin, rows = thinned(outputs, rows, depths.shape, stride)
    if not moved:
        return Placed(as_stored(frame.to_world(thin, rows)), rows, len(outputs["opacities"]), depths, dropped, 0)
    own = rows[rows < depths.size]
    if len(own) < len(rows):
        dropped = {**dropped, REPLACED: len(rows) - len(own)}
    gaussians = _smoothed(frame.to_world(thin, own), (stride * depths).ravel()[own], own // depths[0].size, views)
    coarse = coarse or views
    sheet, around = backdrop(coarse, _farthest(depths, coarse), gaussians.harmonics.shape[1])
    rows = np.concatenate([own, depths.size + np.arange(len(sheet))])
    return Placed(as_stored(joined(gaussians, sheet)), rows, depths.size + around, depths, dropped, len(sheet))


def _farthest(depths: NDArray[np.float64], views: Sequence[FittedView]) -> NDArray[np.float64]:
    """(V, h, w), the size of `views`: the largest of the `depths` (V, k h, k w) in each pixel."""
    height, width = views[0].image.shape[1:]
    squares = (len(views), height, depths.shape[1] // height, width, depths.shape[2] // width)
    return depths.reshape(squares).max(axis=(2, 4))


def _smoothed(
    gaussians: Gaussians, depths: NDArray[np.float64], owner: NDArray[np.intp], views: Sequence[FittedView]
) -> Gaussians:
    """Gaussians convolved with an isotropic one of SMOOTHING px^2 of their view, so that larger renders show surfaces
    and not the pixel grid (3D smoothing filter, Yu et al., Mip-Splatting, 2024). `depths` (N,) are z-depths times the
    stride, `owner` (N,) the indices of their views."""
    focal = np.array([np.sqrt(view.camera.fx * view.camera.fy) for view in views])
    pixel = depths / focal[owner]
    squares = gaussians.scales.astype(np.float64) ** 2 + SMOOTHING * pixel[:, None] ** 2
    return replace(gaussians, scales=np.sqrt(squares).astype(np.float32))


def mended(
    scene: Placed,
    views: Sequence[FittedView],
    cameras: SceneViews,
    passes: int,
    threads: int | None,
    done: Callable[[int], None] | None = None,
    *,
    resized: Sequence[PackedView] = (),
) -> Fading:
    """The scene after `faded`, with targets `views` and `resized`, and with anchors for up to ANCHORED_VIEWS views.
    Gaussians behind the scene keep a minimum opacity (`fading.BEHIND_KEEPS`); those around the photographs may vanish.
    `passes`, `threads` and `done` are those of `faded`."""
    options: dict[str, Any] = {"threads": threads, **cameras.near_plane}
    of_pixel = scene.of_pixel
    sure = np.zeros(len(scene.rows), np.bool_)
    if passes and len(views) <= ANCHORED_VIEWS:
        sure[of_pixel] = confirmed(views, scene.depths).ravel()[scene.rows[of_pixel]]
    kept = anchors(scene.gaussians, sure, of_pixel & ~sure, [view.camera for view in views], **options)
    behind = ~of_pixel & (scene.rows < scene.around)
    return faded(scene.gaussians, views, passes, behind=behind, resized=resized, anchors=kept, done=done, **options)
