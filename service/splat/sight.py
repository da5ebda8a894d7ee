"""What one camera sees of a set of Gaussians, projected and put in order once: to be drawn, and to be weighed."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..gaussians import Gaussians
from .binning import Grid, TileLists, tile_lists
from .definition import Definition
from .options import checked_size
from .order import depth_order
from .parallel import checked_threads
from .prepare import prepared
from .project import Projection, project


@dataclass(frozen=True, eq=False)
class Sight:
    """A projection whose arrays are nobody else's as long as the context of `sight` lasts."""

    gaussians: Gaussians
    camera: Camera
    definition: Definition
    threads: int
    grid: Grid
    projection: Projection
    order: NDArray[np.int32]  # (M,) what is drawn, nearest first
    seconds: dict[str, float]  # of each stage
    _binned: list[TileLists] = field(default_factory=list)  # kept where one batch is all

    @property
    def several(self) -> bool:
        """Whether more than one batch of lists is needed."""
        return int(self.projection.counts.sum()) > self.definition.max_entries

    def lists(self) -> Iterable[TileLists]:
        """Of every tile, in batches as `tile_lists` makes them."""
        batches = tile_lists(self.projection, self.order, self.grid, self.definition.max_entries, self.threads)
        if self.several:
            return batches
        if not self._binned:
            self._binned.extend(batches)
        return self._binned


@contextmanager
def sight(
    gaussians: Gaussians, camera: Camera, definition: Definition, degree: int, threads: int | None
) -> Iterator[Sight]:
    """Raises `InputError` for a size or a number of threads that makes no sense."""
    threads, grid = checked_threads(threads), checked_size(camera)
    clock = [time.perf_counter()]
    scene = prepared(gaussians, threads)
    clock.append(time.perf_counter())
    with scene.workspace() as space:
        projection = project(scene, camera, definition, degree, threads, space)
        clock.append(time.perf_counter())
        order = depth_order(space.depths, projection.drawn, gaussians)
        clock.append(time.perf_counter())
        seconds = dict(zip(("prepare", "project", "order"), np.diff(clock).tolist(), strict=True))
        yield Sight(gaussians, camera, definition, threads, grid, projection, order, seconds)
