"""Progress as events: the work emits `Stage` values, whoever listens decides how to show them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """One event: `done` of `total` steps of the stage `name`; `seconds` is set when the stage has ended."""

    name: str
    done: int
    total: int
    seconds: float | None = None


Listener = Callable[[Stage], None]


def silent(_: Stage) -> None:
    """A listener that shows nothing."""


class Stages:
    """Times named stages and tells a listener about them; `timings` holds seconds per stage in order."""

    def __init__(self, listener: Listener = silent) -> None:
        self._listener = listener
        self.timings: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str, total: int = 1) -> Iterator[Callable[[int], None]]:
        """Run a stage; call the yielded function with the number of steps done so far."""
        self._listener(Stage(name, 0, total))
        start = time.perf_counter()
        yield lambda done: self._listener(Stage(name, done, total))
        elapsed = time.perf_counter() - start
        self.timings[name] = self.timings.get(name, 0.0) + elapsed
        self._listener(Stage(name, total, total, elapsed))
