"""The gates: so many uploads at once, so many jobs on the CPU, so many waiting for it, one computation per scene."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import TypeVar

import anyio
import anyio.to_thread

from ..errors import ServiceBusy

T = TypeVar("T")


class Places:
    """A bounded number of requests that may do something at the same time; one more raises `ServiceBusy`."""

    def __init__(self, most: int, doing: str) -> None:
        self._taken = 0
        self._most = most
        self._doing = doing

    def check(self) -> None:
        """Raise `ServiceBusy` when no place is free."""
        if self._taken >= self._most:
            raise ServiceBusy(
                f"{self._taken} requests are {self._doing}, the limit is {self._most}", cure="retry later"
            )

    @asynccontextmanager
    async def place(self) -> AsyncIterator[None]:
        """Hold a place for the length of the block."""
        self.check()
        self._taken += 1
        try:
            yield
        finally:
            self._taken -= 1


class Gate:
    """Runs functions on worker threads; beyond `slots` running and `waiting` queued it raises `ServiceBusy`."""

    def __init__(self, slots: int, waiting: int) -> None:
        self._limiter = anyio.CapacityLimiter(slots)
        self.places = Places(slots + waiting, "running or waiting")
        self._locks: dict[str, tuple[asyncio.Lock, list[None]]] = {}

    def admitted(self) -> AbstractAsyncContextManager[None]:
        """Hold a place in the queue for the length of the block."""
        return self.places.place()

    @asynccontextmanager
    async def alone(self, key: str) -> AsyncIterator[None]:
        """Only one task at a time is inside the block with the same key; the lock goes when nobody wants it."""
        lock, holders = self._locks.setdefault(key, (asyncio.Lock(), []))
        holders.append(None)
        try:
            async with lock:
                yield
        finally:
            holders.pop()
            if not holders:
                del self._locks[key]

    async def run(self, function: Callable[[], T]) -> T:
        """Run on a worker thread when a slot is free, so that the event loop keeps answering."""
        return await anyio.to_thread.run_sync(function, limiter=self._limiter)
