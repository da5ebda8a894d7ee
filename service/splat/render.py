"""Draw Gaussians as a camera sees them: project, order, bin, blend, composite."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import InputError
from ..gaussians import Gaussians
from .binning import Grid, tile_lists
from .blend import blend, composite_rows, start_planes
from .definition import Definition
from .order import depth_order
from .parallel import checked_threads, run_ranges
from .project import DRAWN, project


@dataclass(frozen=True, eq=False)
class Render:
    """An image of H x W px, in float32 (the reference's in float64).

    `stats` says what was drawn, what was not and why, and the seconds of each stage.
    """

    rgb: NDArray[np.floating]  # (H, W, 3) over the background, >= 0, not clipped at 1
    alpha: NDArray[np.floating]  # (H, W) 1 - transmittance
    depth: NDArray[np.floating]  # (H, W) expected z-depth, sum w z / sum w; 0 where alpha is 0
    stats: dict[str, Any]

    def rgb8(self) -> NDArray[np.uint8]:
        """(H, W, 3) clipped to [0, 1] and rounded to 8 bits."""
        return (np.clip(self.rgb, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Sequence[float] | None = None,
    sh_degree: int | None = None,
    near: float | None = None,
    threads: int | None = None,
    definition: Definition | None = None,
) -> Render:
    """Draw the Gaussians; `definition.py` says what image that is, `reference.py` computes the same in float64.

    `background` is three numbers (black), `sh_degree` the highest band used (all there are), `near` the nearest z-depth
    in the caller's units (0.01), `threads` the number of CPU threads (all). The image has the same bits for every
    number of threads and every order of the input, and differs from the float64 one by at most 1e-5, apart from pixels
    at which a Gaussian lies on the very edge of a cut (alpha_min, stop, near, equal depths).

    Raises `InputError` for a background, degree, plane or thread count that makes no sense.
    """
    definition = checked_definition(definition, near)
    behind = checked_background(background)
    degree = checked_degree(sh_degree, gaussians)
    threads = checked_threads(threads)
    grid = Grid(camera.width, camera.height)

    clock = [time.perf_counter()]
    projection = project(gaussians, camera, definition, degree, threads)
    clock.append(time.perf_counter())
    order = depth_order(projection.depths, projection.status == DRAWN, gaussians)
    clock.append(time.perf_counter())
    planes = start_planes(grid)
    entries = batches = 0
    binning = 0.0
    lists = tile_lists(projection.footprints, order, grid, definition.max_entries, threads)
    mark = time.perf_counter()
    for batch in lists:
        binning += time.perf_counter() - mark
        entries += len(batch.members)
        batches += 1
        live = blend(batch, projection.footprints, projection.shades, planes, grid, definition, threads)
        mark = time.perf_counter()
        if live == 0:
            break
    rows = np.linspace(0, grid.height, threads + 1).astype(np.int64)
    run_ranges(lambda first, last: composite_rows(first, last, *planes, behind), rows, threads)
    clock.append(time.perf_counter())

    colour, alpha, depth = planes
    stats = {
        "count": len(gaussians),
        "projected": len(order),
        "culled": projection.culled,
        "crossing_near": projection.crossing,
        "tiles": grid.tiles,
        "entries": entries,
        "batches": batches,
        "seconds": {
            "project": clock[1] - clock[0],
            "order": clock[2] - clock[1],
            "bin": binning,
            "blend": clock[3] - clock[2] - binning,
        },
    }
    return Render(colour, alpha, depth, stats)


def warm_up() -> None:
    """Compile every kernel or load it from the cache, so that the first request does not wait for it."""
    camera = Camera.make(32, 32, 32.0, 32.0, 16.0, 16.0, np.eye(4))
    one = np.ones((1, 3), np.float32)
    gaussians = Gaussians.make(2.0 * one, one, [[1.0, 0.0, 0.0, 0.0]], [0.5], np.zeros((1, 1, 3)))
    render(gaussians, camera, threads=1)


def checked_definition(definition: Definition | None, near: float | None) -> Definition:
    """The definition asked for, with `near` replaced if given."""
    definition = definition or Definition()
    return definition if near is None else replace(definition, near=float(near))


def checked_background(background: Sequence[float] | None) -> NDArray[np.float32]:
    """(3,) finite background colour; None is black."""
    value = np.zeros(3, np.float32) if background is None else np.asarray(background, dtype=np.float32)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise InputError(f"is {background}, need three finite numbers", field="background")
    return value


def checked_degree(sh_degree: int | None, gaussians: Gaussians) -> int:
    """The SH degree to evaluate: the one asked for, at most what the scene has."""
    if sh_degree is None:
        return gaussians.sh_degree
    if sh_degree not in (0, 1, 2, 3):
        raise InputError(f"is {sh_degree}, need 0, 1, 2 or 3", field="sh_degree")
    return min(int(sh_degree), gaussians.sh_degree)
