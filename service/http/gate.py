"""The gate in front of the CPU: so many jobs at once, so many waiting, one computation per scene."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import anyio
import anyio.to_thread

from ..errors import ServiceBusy

T = TypeVar("T")


class Gate:
    """Runs functions on worker threads; beyond `slots` running and `waiting` queued it raises `ServiceBusy`."""

    def __init__(self, slots: int, waiting: int) -> None:
        self._limiter = anyio.CapacityLimiter(slots)
        self._admitted = 0
        self._most = slots + waiting
        self._locks: dict[str, tuple[asyncio.Lock, list[None]]] = {}

    @asynccontextmanager
    async def admitted(self) -> AsyncIterator[None]:
        """Hold a place in the queue for the length of the block."""
        if self._admitted >= self._most:
            raise ServiceBusy(
                f"{self._admitted} requests are running or waiting, the limit is {self._most}", cure="retry later"
            )
        self._admitted += 1
        try:
            yield
        finally:
            self._admitted -= 1

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
