"""What is left of a request's body when it is answered: little is read, so that the connection stays; of more only so
much as lets a client that is still sending see the answer, and the connection ends."""

from __future__ import annotations

import anyio
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .curfew import GRACE_S, Curfew

SMALL, SMALL_S = 64 * 2**10, 5.0  # a body of so many declared bytes is read before the answer, in that time
SLOW = 408  # the answer to a body for which the service has waited long enough
# Behind the answer: two photographs of a telephone, over a line that takes them in that time.
MOST, MOST_S = 16 * 2**20, 10.0


class BodyLeft:
    """ASGI middleware: an answer that begins before the body has ended says `Connection: close`. Its last message waits
    until the client has sent the rest, or as much as is read of it: with bytes unread the system would reset the
    connection, and many clients lose an answer that they have not read yet."""

    def __init__(self, app: ASGIApp, curfew: Curfew) -> None:
        self._app, self._curfew = app, curfew

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
            with self._curfew.until(), anyio.move_on_after(GRACE_S / 2 if self._curfew.over else seconds):
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
            if asked or "expect" not in headers:  # who waits to be told to send has nothing on its way
                await rest(MOST, MOST_S)
            await send({"type": "http.response.body", "body": b"", "more_body": False})
