"""When the time is up that requests have once the process was told to end: who still waits is answered, and why."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import ServiceBusy
from ..problem_document import of_error
from . import problems

GRACE_S = 2  # behind it, for the answers to be sent; then the server ends what is left


class Curfew:
    """Tasks that end when the process has to; all of it belongs to the event loop's thread."""

    def __init__(self) -> None:
        self.over = False
        self._within: dict[object, asyncio.Task[None]] = {}

    @contextmanager
    def until(self) -> Iterator[None]:
        """The block is left where it is then, without a word."""
        task, key = asyncio.current_task(), object()
        assert task is not None
        self._within[key] = task
        try:
            yield
        except asyncio.CancelledError:
            if not self.over or task.uncancel():  # the server ends it, too
                raise
        finally:
            del self._within[key]

    def end(self) -> None:
        """The time is up."""
        self.over = True
        for task in set(self._within.values()):
            task.cancel()


class AnsweredInTime:
    """ASGI middleware: a request that is not answered by then is told so, instead of losing its connection."""

    def __init__(self, app: ASGIApp, curfew: Curfew, seconds: float) -> None:
        self._app, self._curfew, self._seconds = app, curfew, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = done = False

        async def watched(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        with self._curfew.until():
            await self._app(scope, receive, watched)
            done = True
        if not done and not begun:
            error = ServiceBusy(
                f"the service is stopping, and the answer takes more than the {self._seconds:g} s that it has",
                cure="ask again: a reconstruction that was begun goes on, in another process or at the next start",
            )
            await problems.of_document(of_error(error))(scope, receive, send)
