"""Unread rests of request bodies: a small rest is read, so that the connection can be reused; of a large one only
enough for a client that is still sending to see the answer, and the connection is closed."""

from __future__ import annotations

import anyio
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .shutdown_deadline import GRACE_S, ShutdownDeadline

SMALL, SMALL_S = 64 * 2**10, 5.0  # a body of at most so many declared bytes is read before the answer, within that time
SLOW = 408  # after this status the rest of a body is not awaited
# After the answer: about two photographs of a telephone.
MOST, MOST_S = 16 * 2**20, 10.0


class BodyLeft:
    """ASGI middleware: an answer that begins before the end of the body has `Connection: close`. It is completed only
    after the rest of the body was read, up to a limit: closing a connection with unread bytes makes the system reset
    it, and many clients then lose the answer."""

    def __init__(self, app: ASGIApp, shutdown_deadline: ShutdownDeadline) -> None:
        self._app, self._deadline = app, shutdown_deadline

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope) if scope["type"] == "http" else Headers()
        declared = headers.get("content-length", "0")
        if declared == "0" and "transfer-encoding" not in headers:
            await self._app(scope, receive, send)
            return
        ended = asked = closing = held = False

        async def watched() -> Message:
            nonlocal ended, asked
            asked = True
            message = await receive()
            ended = ended or not message.get("more_body", False)
            return message

        async def rest(most: int, seconds: float) -> None:
            with self._deadline.until(), anyio.move_on_after(GRACE_S / 2 if self._deadline.over else seconds):
                while not ended and most > 0:
                    most -= len((await watched()).get("body", b""))

        async def answered(message: Message) -> None:
            nonlocal closing, held
            if message["type"] == "http.response.start" and not ended:
                comes = message["status"] != SLOW and (asked or "expect" not in headers)
                if comes and declared.isdecimal() and 0 < int(declared) <= SMALL:
                    await rest(SMALL, SMALL_S)
                closing = not ended
                if closing:
                    MutableHeaders(scope=message)["Connection"] = "close"
            elif closing and not message.get("more_body", False):
                held, message = True, {**message, "more_body": True}
            await send(message)

        await self._app(scope, watched, answered)
        if held:
            if asked or "expect" not in headers:  # a client that waits for 100 Continue has sent nothing
                await rest(MOST, MOST_S)
            await send({"type": "http.response.body", "body": b"", "more_body": False})
