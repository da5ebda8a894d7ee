"""The gates: so many uploads at once, so many pictures at a time, so many waiting, no work for a client that left."""

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

T = TypeVar("T")
Gone = Callable[[], Awaitable[bool]]  # whether the client has gone away
Pause = Callable[[], None]  # for the worker thread

GLANCE_S = 0.1  # between two looks whether it has


class Places:
    """A bounded number of requests that may do something at the same time; one more raises `ServiceBusy`."""

    def __init__(self, name: str, most: int, doing: str) -> None:
        """`name` is what the metrics call them, `doing` what a refusal says of those who have one."""
        self.most = most
        self._doing = doing
        self._gauge = PLACES.labels(name)
        self._take(0)

    def check(self) -> None:
        """Raise `ServiceBusy` when no place is free."""
        if self.taken >= self.most:
            raise ServiceBusy(f"{self.taken} requests are {self._doing}, the limit is {self.most}", cure="retry later")

    @asynccontextmanager
    async def place(self) -> AsyncIterator[None]:
        """Hold a place for the length of the block."""
        self.check()
        self._take(self.taken + 1)
        try:
            yield
        finally:
            self._take(self.taken - 1)

    def _take(self, taken: int) -> None:
        self.taken = taken
        self._gauge.set(taken)


class Lane:
    """Runs functions on worker threads, `slots` at a time in the order of arrival; `waiting` more may queue."""

    def __init__(self, name: str, slots: int, waiting: int, patience_s: float, doing: str) -> None:
        """`name` and `doing` as of `Places`."""
        self._turns = asyncio.Semaphore(slots)
        self._threads = anyio.CapacityLimiter(slots + waiting)  # its own: what pauses keeps its thread
        self._patience_s = patience_s
        self.places = Places(name, slots + waiting, doing)

    async def run(self, function: Callable[[], T], gone: Gone) -> T:
        """Wait for a turn, then run, so that the event loop keeps answering.

        Raises `ServiceBusy` where the lane is full or the wait too long, and `ClientDisconnect` where nobody waits.
        """
        return await self.run_in_steps(lambda _: function(), gone)

    async def run_in_steps(self, function: Callable[[Pause], T], gone: Gone) -> T:
        """As `run`, for work of several steps, which calls what it is given between two of them: there those come first
        who have waited meanwhile, and `ClientDisconnect` or `ServiceBusy` ends it as they would before the first."""
        async with self.places.place():
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
        turn = asyncio.ensure_future(self._turns.acquire())  # one wait, so that the order of arrival is kept
        start = time.monotonic()
        try:
            while not (await asyncio.wait({turn}, timeout=GLANCE_S))[0]:
                if await gone():
                    raise ClientDisconnect
                if time.monotonic() - start > self._patience_s:
                    raise ServiceBusy(f"no turn within {self._patience_s:g} s", cure="retry later")
        except BaseException:
            if not turn.cancel():  # it came at this very moment
                self._turns.release()
            raise
