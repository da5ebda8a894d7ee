"""A set of Gaussians projected into one camera and sorted once, for rendering and for sensitivities."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..cameras.camera import Camera
from ..errors import InputError
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
    """A sorted projection, whose buffers are exclusive within the context of `sight`."""

    gaussians: Gaussians
    camera: Camera
    definition: Definition
    threads: int
    grid: Grid
    projection: Projection
    order: NDArray[np.int32]  # (M,) indices of drawn Gaussians, nearest first
    seconds: dict[str, float]  # of each stage
    _binned: list[TileLists] = field(default_factory=list)  # cached where there is a single batch

    @property
    def several(self) -> bool:
        """Whether the tile lists need more than one batch."""
        return int(self.projection.counts.sum()) > self.definition.max_entries

    def lists(self) -> Iterable[TileLists]:
        """The batches of tile lists (`tile_lists`); a single one is cached."""
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
    """Project and sort `gaussians` for `camera`. Raises `InputError` for a size or number of threads out of range, and
    where memory does not suffice, here or for what is drawn within the context."""
    threads, grid = checked_threads(threads), checked_size(camera)
    try:
        with _projected(gaussians, camera, definition, degree, threads, grid) as seen:
            yield seen
    except MemoryError as error:
        message = f"{camera.width} x {camera.height} px do not fit into the memory that is free"
        cure = "draw it smaller, or in parts, each by a cropped camera"
        raise InputError(message, field="camera.size", cure=cure) from error


@contextmanager
def _projected(
    gaussians: Gaussians, camera: Camera, definition: Definition, degree: int, threads: int, grid: Grid
) -> Iterator[Sight]:
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
