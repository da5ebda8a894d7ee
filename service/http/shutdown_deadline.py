"""The deadline of requests during shutdown: those that are not finished then are answered with 503."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import ServiceBusy
from ..problem_document import of_error
from . import problems

GRACE_S = 2  # after it, to send these answers; then the server closes the connections


class ShutdownDeadline:
    """Tasks that are cancelled at the deadline. To be used from the event loop's thread only."""

    def __init__(self) -> None:
        self.over = False
        self._within: dict[object, asyncio.Task[None]] = {}

    @contextmanager
    def until(self) -> Iterator[None]:
        """The block is cancelled at the deadline, and left without an error."""
        task, key = asyncio.current_task(), object()
        assert task is not None
        self._within[key] = task
        try:
            yield
        except asyncio.CancelledError:
            if not self.over or task.uncancel():  # the server has cancelled it, too
                raise
        finally:
            del self._within[key]

    def end(self) -> None:
        """The deadline is reached: cancel all blocks."""
        self.over = True
        for task in set(self._within.values()):
            task.cancel()


class AnsweredInTime:
    """ASGI middleware: 503 for a request that has no answer at the deadline, instead of a closed connection."""

    def __init__(self, app: ASGIApp, shutdown_deadline: ShutdownDeadline, seconds: float) -> None:
        self._app, self._deadline, self._seconds = app, shutdown_deadline, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = done = False

        async def watched(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        with self._deadline.until():
            await self._app(scope, receive, watched)
            done = True
        if not done and not begun:
            error = ServiceBusy(
                f"the service is stopping, and the answer takes more than the {self._seconds:g} s that it has",
                cure="ask again: a reconstruction that was begun goes on, in another process or at the next start",
            )
            await problems.of_document(of_error(error))(scope, receive, send)
