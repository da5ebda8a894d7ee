"""Rendering of Gaussians from a camera: project, sort, bin, blend."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .binning import TileLists
from .blend import Canvas, blend
from .definition import Definition
from .options import (
    ANALYSIS,
    check_types,
    checked_background,
    checked_definition,
    checked_degree,
    checked_outputs,
    checked_subset,
)
from .prepare import DEPTH
from .sight import Sight, sight
from .tile_state import BLOCKS, bytes_of, tile_floats
from .vectors import ALL_CHANNELS, COLOURS_ONLY, WITH_DEPTH


def nothing() -> NDArray[np.float32]:
    """The empty plane (0, 0) in place of an output that was not requested."""
    return np.empty((0, 0), np.float32)


def to_bytes(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """uint8 of the same shape: `values` clipped to [0, 1], times 255, rounded; NaN becomes 0."""
    out = np.empty(values.shape, np.uint8)
    bytes_of(np.ascontiguousarray(values, np.float32).ravel(), out.ravel())
    return out


@dataclass(frozen=True, eq=False)
class Render:
    """An image of H x W px in float32 (of the reference in float64); planes that were not requested are empty.

    `stats` has counts of drawn and culled Gaussians by reason, and the seconds of each stage. `blocks` counts blended
    pairs of a listed Gaussian and a block of 8 x 8 px, `skipped` the other pairs; `pairs`, if requested, counts blended
    pairs of a Gaussian and a pixel.
    """

    rgb: NDArray[np.floating]  # (H, W, 3) over the background, not clipped
    alpha: NDArray[np.floating]  # (H, W) 1 - transmittance
    depth: NDArray[np.floating]  # (H, W) expected z-depth, sum w z / sum w; 0 where alpha is 0
    stats: dict[str, Any]
    # (H, W) median z-depth, of the Gaussian that brings the transmittance to 1/2 or below; 0 if none does
    median: NDArray[np.floating] = field(default_factory=nothing)
    # (H, W) summed weights of the Gaussians in `subset`: the mass that removing them frees
    removed: NDArray[np.floating] = field(default_factory=nothing)
    # (N,) largest weight of each Gaussian at any pixel
    peaks: NDArray[np.floating] = field(default_factory=nothing)

    def rgb8(self) -> NDArray[np.uint8]:
        """(H, W, 3) clipped to [0, 1] and rounded to 8 bits."""
        return to_bytes(self.rgb)

    def rgba8(self) -> NDArray[np.uint8]:
        """(H, W, 4) with straight (unpremultiplied) alpha, for compositing; of an image drawn over black. Raises
        `InputError` without the output "alpha"."""
        if self.alpha.shape != self.rgb.shape[:2]:
            raise InputError("the opacity was not computed, ask for it by outputs=('alpha',)", field="outputs")
        colour = self.rgb / np.maximum(self.alpha, 1e-6)[..., None]
        return to_bytes(np.concatenate([colour, self.alpha[..., None]], axis=2))


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Sequence[float] | None = None,
    sh_degree: int | None = None,
    near: float | None = None,
    threads: int | None = None,
    definition: Definition | None = None,
    compatibility: str | None = None,
    outputs: Collection[str] = ("alpha", "depth"),
    subset: NDArray[np.bool_] | None = None,
    between: Callable[[], None] | None = None,
) -> Render:
    """Render the Gaussians as `definition.py` specifies; `reference.py` computes the same in float64.

    `background`: three numbers; black by default. `sh_degree`: highest band of harmonics; all by default.
    `near`: nearest z-depth, caller's units; that of the definition by default. `threads`: CPU threads; all by default.
    `compatibility`: "inria" for the rules of the reference rasteriser, in place of a `definition`.
    `outputs`: planes to compute beside the colours, of `OUTPUTS`. `subset`: mask (N,) that the output "removed" sums.
    `between`: called between batches of tile lists (`Definition.max_entries`); it may raise to abort.

    The image has the same bits for every number of threads, order of the input and choice of outputs. With a dilation,
    alpha_min and stop no smaller than the defaults and no larger alpha_max, opacities differ from the float64 reference
    by at most 1.2e-5, and colours by that and 6e-8 for each layer, times the largest colour if that is above 1; except
    at pixels where a Gaussian lies exactly on a cut-off (alpha_min, cut_radius, stop, near, equal depths).

    Raises `InputError` for a background, degree, plane, thread count, output, subset or size out of range.
    """
    check_types(gaussians, camera)
    definition = checked_definition(definition, near, compatibility)
    behind = checked_background(background)
    degree = checked_degree(sh_degree, gaussians)
    outputs = checked_outputs(outputs)
    marked = checked_subset(outputs, subset, gaussians)
    with sight(gaussians, camera, definition, degree, threads) as view:
        return draw(view, outputs, marked, behind, between)


def draw(
    view: Sight,
    outputs: Collection[str],
    marked: NDArray[np.bool_] | None,
    background: NDArray[np.float32],
    between: Callable[[], None] | None = None,
) -> Render:
    """`render` of a projected set; `marked` (N,) is the mask for "removed", which stays marked in the records."""
    start = time.perf_counter()
    projection, order, definition, grid = view.projection, view.order, view.definition, view.grid
    records, count = projection.space.records, len(view.gaussians)
    if marked is not None:  # a depth with a minus sign marks a Gaussian, see `vectors.py`
        rows = projection.drawn[marked[projection.drawn]]
        records.view(np.float32)[rows, DEPTH] *= -1
    canvas = new_canvas(view.camera, outputs, count, grid.tiles if view.several else 0, background)
    entries = batches = blocks = pairs = 0
    binning, mark = 0.0, time.perf_counter()
    for lists in view.lists():
        binning += time.perf_counter() - mark
        if between is not None:
            between()
        found = blend(lists, records, canvas, grid, definition, view.threads, first_batch=batches == 0)
        entries, batches = entries + len(lists.members), batches + 1
        blocks, pairs = blocks + found.blocks, pairs + found.pairs
        mark = time.perf_counter()
        if not (found.unfinished or lists.last):  # what lies behind is hidden everywhere
            rest = TileLists(np.zeros(grid.tiles + 1, np.int64), np.empty(0, np.int32), True)
            blend(rest, records, canvas, grid, definition, view.threads, first_batch=False)
            break
    seconds = {**view.seconds, "bin": binning, "blend": time.perf_counter() - start - binning}

    stats = {
        "count": count,
        "projected": len(order),
        "culled": projection.culled,
        "crossing_near": projection.crossing,
        "tiles": grid.tiles,
        "entries": entries,
        "batches": batches,
        "blocks": blocks,
        "skipped": entries * BLOCKS - blocks,
        **({"pairs": pairs} if "pairs" in outputs else {}),
        "seconds": seconds,
    }
    planes = {
        name: plane if name in outputs and plane is not None else nothing()
        for name, plane in (
            ("alpha", canvas.alpha), ("depth", canvas.depth), ("median", canvas.median), ("removed", canvas.removed),
        )
    }  # fmt: skip
    peaks = canvas.peaks if "peaks" in outputs and canvas.peaks is not None else nothing().ravel()
    return Render(canvas.rgb, **planes, peaks=peaks, stats=stats)


def new_canvas(
    camera: Camera, outputs: Collection[str], count: int, tiles: int, background: NDArray[np.float32]
) -> Canvas:
    """The planes of `outputs` and those computed along with them, and the states of `tiles` for several batches."""
    shape = camera.height, camera.width
    everything = any(name in outputs for name in ANALYSIS)
    channels = ALL_CHANNELS if everything else WITH_DEPTH if "depth" in outputs else COLOURS_ONLY
    more = [np.empty(shape, np.float32) if everything else None for _ in range(2)]
    return Canvas(
        rgb=np.empty((*shape, 3), np.float32),
        alpha=np.empty(shape if "alpha" in outputs else (0, 0), np.float32),
        depth=np.empty(shape, np.float32) if channels != COLOURS_ONLY else None,
        median=more[0],
        removed=more[1],
        peaks=np.zeros(count, np.float32) if everything else None,
        state=np.empty((tiles, tile_floats(channels)), np.float32),
        background=background,
    )


def render_views(gaussians: Gaussians, cameras: Iterable[Camera], **options: Any) -> list[Render]:
    """`render` for each camera with the same options; the camera-independent part is computed once."""
    return [render(gaussians, camera, **options) for camera in cameras]
