"""What is done after the network: depths move, a backdrop stands behind them, opacities and colours are corrected."""

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
from ..photographs.masks import REPLACED, kept_rows
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

MOVED = frozenset(GAUSSIAN_OUTPUTS) - {"opacities"}  # once they stand in the world, the network's need no memory
CONTINUED_VIEWS = 3  # of more, others confirm nearly all that is seen, and planes lose
ANCHORED_VIEWS = 3  # of more, photographs contradict what floats, and things that none of them confirms would fade
SMOOTHING = 0.1  # px^2 in the input, added to all three variances


@dataclass(frozen=True, eq=False)
class Placed:
    """Gaussians in the caller's world, and what each of them is."""

    gaussians: Gaussians  # with the positions that the .ply will hold
    rows: NDArray[np.intp]  # (N,) the pixels' in order, then those of what stands behind the scene;
    around: int  # and from this row on of what stands around the photographs
    depths: NDArray[np.float64]  # (V, H, W) z-depths of the pixels, in the cameras' units
    dropped: dict[str, int]  # of the network's Gaussians, by reason
    added: int  # that are not the network's

    @property
    def of_pixel(self) -> NDArray[np.bool_]:
        """(N,) which belong to a pixel."""
        return self.rows < self.depths.size

    @property
    def owner(self) -> NDArray[np.intp]:
        """(N,) the view whose pixel it is, V for one of none."""
        return np.minimum(self.rows // self.depths[0].size, len(self.depths))


@freed_blocks_reused()
def at_mended_depths(
    outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], far: float, threads: int | None = None
) -> Arrays:
    """The network's outputs with every pixel's Gaussian where the photographs match best: close to its depth, then
    anywhere in the scene's range, then on the planes of what is confirmed; what nothing confirms where a small network
    that was trained for it prefers it; a blank backdrop at `far`, the scene's end, a z-depth in the caller's units."""
    network = frame.depths(outputs)
    matched, depths = matched_depths(views, network, threads)
    if len(views) == 2:  # of more, others confirm most of what is seen, and photographs lose by it
        depths = chosen(views, depths, (network, matched), shipped_choice())
    return frame.at_depths(outputs, [view.camera for view in views], blank_moved(views, depths, far))


def matched_depths(
    views: Sequence[FittedView], depths: NDArray[np.float64], threads: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(V, H, W) z-depths from those of the network, as photographs match and then as planes go on."""
    count = len(views)
    if count == 2:  # of more, others confirm most of what is seen, and planes gain nothing before the search
        depths = continued(views, depths)
    matched = refined(views, searched(views, refined(views, depths), threads))
    if count == 2:
        return matched, continued_finely(views, matched)
    return matched, continued(views, matched) if count <= CONTINUED_VIEWS else matched


@freed_blocks_reused()
def at_finer_depths(outputs: Arrays, frame: WorldFrame, views: Sequence[FittedView], far: float) -> Arrays:
    """The same where outputs at mended depths were made finer (`detail.py`): only close to their depths, and on planes
    of two views; a blank backdrop stays at `far`."""
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
    """The network's Gaussians that belong into the scene, one for a square of `stride` px; where depths have `moved`, a
    backdrop of these depths instead of the network's own. Where `views` are finer than what the network saw, `coarse`
    are that: the backdrop's cells are as wide as so many of its pixels, and stand behind the farthest of the fine."""
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
    """(V, h, w) for the pixels of `views`, of depths (V, k h, k w)."""
    height, width = views[0].image.shape[1:]
    squares = (len(views), height, depths.shape[1] // height, width, depths.shape[2] // width)
    return depths.reshape(squares).max(axis=(2, 4))


def _smoothed(
    gaussians: Gaussians, depths: NDArray[np.float64], owner: NDArray[np.intp], views: Sequence[FittedView]
) -> Gaussians:
    """Wider by SMOOTHING of its view's pixel each, so that a larger picture shows surfaces, not the grid of the pixels
    (the 3D smoothing filter of Yu et al., Mip-Splatting, 2024); `depths` (N,) times the stride and `owner` (N,)."""
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
    """Faded and recoloured by `views`, in the end by the same at another size too (`resized`, as for `faded`); what
    stands behind the scene keeps more than half of its opacity, since it is there for views that nobody has asked for,
    what stands around it nothing."""
    options: dict[str, Any] = {"threads": threads, **cameras.near_plane}
    of_pixel = scene.of_pixel
    sure = np.zeros(len(scene.rows), np.bool_)
    if passes and len(views) <= ANCHORED_VIEWS:
        sure[of_pixel] = confirmed(views, scene.depths).ravel()[scene.rows[of_pixel]]
    kept = anchors(scene.gaussians, sure, of_pixel & ~sure, [view.camera for view in views], **options)
    behind = ~of_pixel & (scene.rows < scene.around)
    return faded(scene.gaussians, views, passes, behind=behind, resized=resized, anchors=kept, done=done, **options)
