"""Arrays between guards: kernels write without bounds checks, and memory beside their arrays must not change."""

from __future__ import annotations

import numpy as np

GUARD = 4096  # bytes on either side
PATTERN = 0xA5


class Guarded:
    """Arrays in the middle of larger buffers."""

    def __init__(self):
        self.buffers = []

    def array(self, shape, dtype):
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        buffer = np.full(2 * GUARD + size, PATTERN, np.uint8)
        self.buffers.append(buffer)
        return buffer[GUARD : GUARD + size].view(dtype).reshape(shape)

    def check(self):
        for buffer in self.buffers:
            assert (buffer[:GUARD] == PATTERN).all()
            assert (buffer[-GUARD:] == PATTERN).all()


def beside_nan(values: np.ndarray) -> np.ndarray:
    """The same values, in the middle of a buffer of NaN."""
    buffer = np.full(values.size + 512, np.nan, values.dtype)
    buffer[256 : 256 + values.size] = values.ravel()
    return buffer[256 : 256 + values.size].reshape(values.shape)
