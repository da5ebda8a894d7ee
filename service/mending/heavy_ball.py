"""Numbers that go downhill in steps and keep some of their way: the heavy ball of Polyak (1964)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MOMENTUM = 0.4  # share of its last way that a number goes again


@dataclass(eq=False)
class HeavyBall:
    """Numbers of any shape, each between its `least` and its `most`, or as far beyond as it was at the `start`."""

    start: NDArray[np.float32]
    least: NDArray[np.floating] | float
    most: NDArray[np.floating] | float
    now: NDArray[np.float32] = field(init=False)
    _last: NDArray[np.float32] | float = field(default=0.0, init=False)  # way really gone, momentum and limits included

    def __post_init__(self) -> None:
        self.now = self.start

    def move(self, step: NDArray[np.float64]) -> None:
        """By `step` and MOMENTUM of the last way, then back within the limits."""
        least, most = np.minimum(self.start, self.least), np.maximum(self.start, self.most)
        new = np.clip(self.now + step + MOMENTUM * self._last, least, most).astype(np.float32)
        self.now, self._last = new, new - self.now
