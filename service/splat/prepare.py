"""The camera-independent part of rendering a set: its factors R S and log opacities in float64, in blocks.

A block stores 256 Gaussians field by field (structure of arrays), so that one vector instruction handles eight of them;
the last is padded with Gaussians of opacity 0. It is computed once per set and cached as long as the set lives.
"""

from __future__ import annotations

import math
import threading
import weakref
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..gaussians import Gaussians
from .access import BLOCK, get, put_field
from .kernel_cache import kernel
from .parallel import run_ranges

FIELDS = 14  # mean (3), R S row by row (9), opacity, natural logarithm of the opacity
MEAN, FACTOR, OPACITY, LOG_OPACITY = 0, 3, 12, 13
# A record is 8 doubles: x, y, HALF_LOG2E / l1, k, HALF_LOG2E / l2, then 6 floats: log2 opacity, r, g, b, z, log2 cut.
RECORD = 8
LOG2_OPACITY, RED, DEPTH, LOG2_CUT = 10, 11, 14, 15  # indices of these floats when a record is viewed as 16 floats
EXTENT = 3  # doubles: half width and height of the bounding box, px, and the shear of the transposed factor


@dataclass(frozen=True, eq=False)
class Workspace:
    """Buffers for the projection of N Gaussians, reused when the set is rendered again."""

    records: NDArray[np.float64]  # (N, RECORD)
    extents: NDArray[np.float64]  # (N, EXTENT)
    boxes: NDArray[np.uint64]  # (N,)
    depths: NDArray[np.float64]  # (N,)
    drawn: NDArray[np.int32]  # (N,)

    @classmethod
    def of(cls, count: int) -> Workspace:
        """Uninitialised buffers for `count` Gaussians."""
        return cls(
            np.empty((count, RECORD)), np.empty((count, EXTENT)), np.empty(count, np.uint64), np.empty(count),
            np.empty(count, np.int32),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Prepared:
    """N Gaussians in ceil(N / BLOCK) blocks."""

    count: int
    geometry: NDArray[np.float64]  # (blocks, FIELDS, BLOCK); opacity 0 in the padding of the last
    harmonics: NDArray[np.float32]  # (blocks, K, 3, BLOCK)
    spare: deque[Workspace] = field(default_factory=lambda: deque(maxlen=1))

    @contextmanager
    def workspace(self) -> Iterator[Workspace]:
        """Buffers for exclusive use. One set of them is kept for reuse, but not after an error, when a kernel may still
        be writing to it."""
        try:
            space = self.spare.pop()
        except IndexError:
            space = Workspace.of(self.count)
        yield space
        self.spare.append(space)


_known: weakref.WeakKeyDictionary[Gaussians, Prepared] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def prepared(gaussians: Gaussians, threads: int) -> Prepared:
    """The blocks of a set, cached after the first call; the arrays of the set must not change."""
    with _lock:
        known = _known.get(gaussians)
    if known is not None:
        return known
    count, bands = len(gaussians), gaussians.harmonics.shape[1]
    blocks = -(-count // BLOCK)
    result = Prepared(count, np.empty((blocks, FIELDS, BLOCK)), np.empty((blocks, bands, 3, BLOCK), np.float32))
    # One layout for every caller: numba would compile the kernel again for a strided or read-only array.
    arrays = (
        np.require(gaussians.means, np.float64, ["C", "W"]),
        *(
            np.require(getattr(gaussians, name), np.float32, ["C", "W"])
            for name in ("scales", "rotations_wxyz", "opacities", "harmonics")
        ),
    )
    bounds = np.linspace(0, blocks, (4 * threads if threads > 1 else 1) + 1).astype(np.int64)
    run_ranges(
        lambda first, last: prepare_range(first, last, *arrays, result.geometry, result.harmonics), bounds, threads
    )
    with _lock:
        return _known.setdefault(gaussians, result)


@kernel()
def prepare_range(first, last, means, scales, rotations, opacities, harmonics, geometry, shades):
    """Fill blocks first..last-1."""
    count, bands = means.shape[0], harmonics.shape[1]
    for block in range(first, last):
        for j in range(BLOCK):
            i = block * BLOCK + j
            at, to = block * FIELDS * BLOCK + j, block * bands * 3 * BLOCK + j
            if i >= count:
                for field in range(FIELDS):
                    put_field(geometry, at, field, -np.inf if field == LOG_OPACITY else 0.0)
                for term in range(bands * 3):
                    put_field(shades, to, term, 0.0)
                continue
            for axis in range(3):
                put_field(geometry, at, MEAN + axis, get(means, 3 * i + axis))
            # R from a quaternion that is normalised only to float32.
            w, x = np.float64(get(rotations, 4 * i)), np.float64(get(rotations, 4 * i + 1))
            y, z = np.float64(get(rotations, 4 * i + 2)), np.float64(get(rotations, 4 * i + 3))
            two = 2.0 / (w * w + x * x + y * y + z * z)
            s0, s1 = np.float64(get(scales, 3 * i)), np.float64(get(scales, 3 * i + 1))
            s2 = np.float64(get(scales, 3 * i + 2))
            put_field(geometry, at, FACTOR, s0 * (1.0 - two * (y * y + z * z)))
            put_field(geometry, at, FACTOR + 1, s1 * two * (x * y - w * z))
            put_field(geometry, at, FACTOR + 2, s2 * two * (x * z + w * y))
            put_field(geometry, at, FACTOR + 3, s0 * two * (x * y + w * z))
            put_field(geometry, at, FACTOR + 4, s1 * (1.0 - two * (x * x + z * z)))
            put_field(geometry, at, FACTOR + 5, s2 * two * (y * z - w * x))
            put_field(geometry, at, FACTOR + 6, s0 * two * (x * z - w * y))
            put_field(geometry, at, FACTOR + 7, s1 * two * (y * z + w * x))
            put_field(geometry, at, FACTOR + 8, s2 * (1.0 - two * (x * x + y * y)))
            opacity = np.float64(get(opacities, i))
            put_field(geometry, at, OPACITY, opacity)
            put_field(geometry, at, LOG_OPACITY, math.log(opacity) if opacity > 0.0 else -np.inf)
            for term in range(bands * 3):
                put_field(shades, to, term, get(harmonics, i * bands * 3 + term))
