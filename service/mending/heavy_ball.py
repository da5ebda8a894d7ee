"""Bounded parameters updated by steps with momentum: the heavy-ball method of Polyak (1964)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MOMENTUM = 0.4  # share of the previous update that is added to the next


@dataclass(eq=False)
class HeavyBall:
    """Parameters of any shape, bounded by `least` and `most`, which are widened to include the `start`."""

    start: NDArray[np.float32]
    least: NDArray[np.floating] | float
    most: NDArray[np.floating] | float
    now: NDArray[np.float32] = field(init=False)
    _last: NDArray[np.float32] | float = field(default=0.0, init=False)  # last update, after clipping

    def __post_init__(self) -> None:
        self.now = self.start

    def move(self, step: NDArray[np.float64]) -> None:
        """Add `step` and MOMENTUM times the last update, then clip to the bounds."""
        least, most = np.minimum(self.start, self.least), np.maximum(self.start, self.most)
        new = np.clip(self.now + step + MOMENTUM * self._last, least, most).astype(np.float32)
        self.now, self._last = new, new - self.now
