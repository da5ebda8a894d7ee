"""Limits on concurrent requests: counted slots, and queues that run work on threads in order of arrival."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import anyio.from_thread
import anyio.to_thread
from starlette.requests import ClientDisconnect

from ..errors import ServiceBusy
from ..metrics import PLACES
from ..plain_number import counted

T = TypeVar("T")
Gone = Callable[[], Awaitable[bool]]  # whether the client has disconnected
Pause = Callable[[], None]  # called on the worker thread

GLANCE_S = 0.1  # between checks for that


class ConcurrencyLimit:
    """At most `most` requests at the same time; one more raises `ServiceBusy`."""

    def __init__(self, name: str, most: int, doing: str) -> None:
        """`name` is the label in the metrics; `doing` completes "N requests are ..." in the error."""
        self.most = most
        self._doing = doing
        self._gauge = PLACES.labels(name)
        self._take(0)

    def check(self) -> None:
        """Raises `ServiceBusy` if no slot is free."""
        if self.taken >= self.most:
            are = f"{counted(self.taken, 'request')} {'is' if self.taken == 1 else 'are'}"
            raise ServiceBusy(f"{are} {self._doing}, the limit is {self.most}", cure="retry later")

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[None]:
        """Occupy a slot during the block. Raises `ServiceBusy`."""
        self.check()
        self._take(self.taken + 1)
        try:
            yield
        finally:
            self._take(self.taken - 1)

    def _take(self, taken: int) -> None:
        self.taken = taken
        self._gauge.set(taken)


class WorkQueue:
    """Runs functions on worker threads, `slots` at once in order of arrival; up to `waiting` more may queue."""

    def __init__(self, name: str, slots: int, waiting: int, patience_s: float, doing: str) -> None:
        """A function waits at most `patience_s` for its turn; `name` and `doing` as in `ConcurrencyLimit`."""
        self._turns = asyncio.Semaphore(slots)
        self._threads = anyio.CapacityLimiter(slots + waiting)  # of its own, since a paused function keeps its thread
        self._patience_s = patience_s
        self.limit = ConcurrencyLimit(name, slots + waiting, doing)

    async def run(self, function: Callable[[], T], gone: Gone) -> T:
        """Wait for a turn and run the function on a worker thread.

        Raises `ServiceBusy` if the queue is full or the wait too long, and `ClientDisconnect` if the client has left.
        """
        return await self.run_in_steps(lambda _: function(), gone)

    async def run_in_steps(self, function: Callable[[Pause], T], gone: Gone) -> T:
        """As `run`, for work of several steps. Between two steps the function calls its argument, which lets waiting
        requests run first and raises `ClientDisconnect` or `ServiceBusy` as before the first step."""
        async with self.limit.slot():
            await self._turn(gone)
            held = True

            async def pause() -> None:
                nonlocal held
                self._turns.release()
                held = False
                if await gone():
                    raise ClientDisconnect
                await self._turn(gone)
                held = True

            try:
                return await anyio.to_thread.run_sync(
                    function, lambda: anyio.from_thread.run(pause), limiter=self._threads
                )
            finally:
                if held:
                    self._turns.release()

    async def _turn(self, gone: Gone) -> None:
        turn = asyncio.ensure_future(self._turns.acquire())  # a single wait, which keeps the order of arrival
        start = time.monotonic()
        try:
            while not (await asyncio.wait({turn}, timeout=GLANCE_S))[0]:
                if await gone():
                    raise ClientDisconnect
                if time.monotonic() - start > self._patience_s:
                    raise ServiceBusy(f"no turn within {self._patience_s:g} s", cure="retry later")
        except BaseException:
            if not turn.cancel():  # it was acquired at this moment
                self._turns.release()
            raise
