"""Things that are costly to keep: loaded when one is first used, dropped over a budget, the longest unused first."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(eq=False)
class _Entry(Generic[T]):
    """One thing: `loaded` is there from the moment at which its loading begins, and counts from then on."""

    size: int
    users: int = 0
    used: int = 0  # when somebody last began or ended to use it, in turns
    loaded: Future[T] | None = field(default=None)


class Pool(Generic[T]):
    """Names and what is loaded for them; safe for threads. The sizes of what is loaded never sum up to more than the
    budget, and nothing goes while it is used: whoever needs room that is not there waits for it.

    Who waits goes first: users come in the order in which they asked, so that a busy thing keeps no other out for ever.
    One who uses a thing must not ask for a second one meanwhile, or two could wait for each other.
    """

    def __init__(self, load: Callable[[str], T], sizes: Mapping[str, int], budget: int | None = None) -> None:
        """`load` makes the thing of a name; each of `sizes` must be within the `budget` (None: no limit)."""
        over = [name for name, size in sizes.items() if budget is not None and size > budget]
        if over:
            raise ValueError(f"{', '.join(over)} alone is larger than the budget")
        self._load = load
        self._budget = budget
        self._changed = threading.Condition()
        self._queue: deque[object] = deque()  # who has asked and neither uses it nor loads it yet
        self._turn = 0
        self._entries: dict[str, _Entry[T]] = {name: _Entry(size) for name, size in sizes.items()}

    @contextmanager
    def using(self, name: str) -> Iterator[T]:
        """The thing, for as long as the block lasts; loads it where it is not there, once however many ask at the same
        time. What loading raises is raised for each of them, and the next one tries anew."""
        entry = self._entries[name]
        future, mine = self._enter(entry)
        try:
            if mine:
                self._fill(name, entry, future)
            yield future.result()
        finally:
            self._leave(entry)

    def loaded(self, name: str) -> bool:
        """Whether it is there and ready."""
        with self._changed:
            future = self._entries[name].loaded
            return future is not None and future.done()

    def used_bytes(self) -> int:
        """The sizes of what is loaded or being loaded."""
        with self._changed:
            return self._sum()

    def _enter(self, entry: _Entry[T]) -> tuple[Future[T], bool]:
        """Wait for one's turn and for room, and count as a user; returns the thing, and whether one must load it."""
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
            try:
                while not (self._queue[0] is ticket and self._room_for(entry)):
                    self._changed.wait()
                entry.users += 1
                self._touch(entry)
                mine = entry.loaded is None
                future: Future[T] = entry.loaded or Future()
                entry.loaded = future
                return future, mine
            finally:  # also where waiting was interrupted
                self._queue.remove(ticket)
                self._changed.notify_all()

    def _fill(self, name: str, entry: _Entry[T], future: Future[T]) -> None:
        try:
            future.set_result(self._load(name))
        except BaseException as error:
            with self._changed:
                entry.loaded = None
                self._changed.notify_all()
            future.set_exception(error)

    def _leave(self, entry: _Entry[T]) -> None:
        with self._changed:
            entry.users -= 1
            self._touch(entry)
            self._changed.notify_all()

    def _touch(self, entry: _Entry[T]) -> None:
        self._turn += 1
        entry.used = self._turn

    def _room_for(self, entry: _Entry[T]) -> bool:
        """Whether it is there or may be loaded now; drops what must go for that, and nothing where that is not
        enough."""
        if entry.loaded is not None or self._budget is None:
            return True
        excess = self._sum() + entry.size - self._budget
        idle = [other for other in self._entries.values() if other.loaded and not other.users]
        idle.sort(key=lambda other: other.used)
        going: list[_Entry[T]] = []
        while excess > 0 and idle:
            going.append(idle.pop(0))
            excess -= going[-1].size
        if excess > 0:
            return False
        for other in going:
            other.loaded = None
        return True

    def _sum(self) -> int:
        return sum(entry.size for entry in self._entries.values() if entry.loaded is not None)
