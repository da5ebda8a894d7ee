"""The common bound on all request bodies: which requests are refused, and when the bytes of another are released."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gapmes.service.errors import ServiceBusy, UploadTooLarge
from gapmes.service.http.limits import RELEASE, BodyLimit

Scope = dict[str, Any]


class App:
    """Reads the whole body, reports it, and answers when it may."""

    def __init__(self) -> None:
        self.may_answer = asyncio.Event()
        self.read: list[int] = []
        self.scopes: list[Scope] = []

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        self.scopes.append(scope)
        size, more = 0, True
        while more:
            message = await receive()
            size, more = size + len(message["body"]), message["more_body"]
        self.read.append(size)
        await self.may_answer.wait()


async def ask(limit: BodyLimit, sizes: list[int], declared: int | None = None) -> list[int]:
    """Send a body in pieces of these sizes; returns the statuses of answers."""
    left, answered = list(sizes), []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": bytes(left.pop(0)), "more_body": bool(left)}

    async def send(message: dict[str, Any]) -> None:
        answered.append(message.get("status"))

    headers = [] if declared is None else [(b"content-length", str(declared).encode())]
    await limit({"type": "http", "headers": headers}, receive, send)
    return answered


def test_bodies_together_are_bounded_until_they_are_released_or_answered() -> None:
    async def story() -> None:
        app = App()
        limit = BodyLimit(app, 1000, 1500)
        first = asyncio.create_task(ask(limit, [400, 400]))
        await asyncio.sleep(0)
        with pytest.raises(
            ServiceBusy, match="800 bytes of other requests are in memory, with this one the limit of 1500"
        ):
            await ask(limit, [400, 400])
        second = asyncio.create_task(ask(limit, [400, 300]))
        await asyncio.sleep(0)
        assert app.read == [800, 700]
        app.scopes[0][RELEASE]()  # its photographs are on disk
        third = asyncio.create_task(ask(limit, [800]))
        await asyncio.sleep(0)
        assert app.read == [800, 700, 800]
        app.may_answer.set()
        await asyncio.gather(first, second, third)
        await asyncio.gather(*(ask(limit, [750]) for _ in range(2)))
        assert app.read[3:] == [750, 750]

    asyncio.run(story())


def test_one_body_alone_may_pass_the_bound_on_all_together() -> None:
    async def story() -> None:
        app = App()
        app.may_answer.set()
        await ask(BodyLimit(app, 1000, 500), [600, 300])
        assert app.read == [900]
        with pytest.raises(UploadTooLarge, match="1001 bytes or more, the limit is 1000"):
            await ask(BodyLimit(app, 1000, 500), [600, 401])

    asyncio.run(story())


@pytest.mark.parametrize("declared", [None, 1000])
def test_a_body_of_just_the_bound_is_taken(declared: int | None) -> None:
    async def story() -> None:
        app = App()
        app.may_answer.set()
        assert await ask(BodyLimit(app, 1000, 500), [600, 400], declared) == []
        assert app.read == [1000]
        assert (await ask(BodyLimit(app, 1000, 500), [], 1001))[0] == 413  # by its declared length: nothing is read

    asyncio.run(story())


def test_what_was_released_is_not_released_again_by_the_answer() -> None:
    """The bound on all together stays where it is."""

    async def story() -> None:
        app = App()
        limit = BodyLimit(app, 1000, 1500)
        first = asyncio.create_task(ask(limit, [1000]))
        await asyncio.sleep(0)
        app.scopes[0][RELEASE]()
        app.may_answer.set()
        await first
        app.may_answer.clear()
        second = asyncio.create_task(ask(limit, [800]))
        await asyncio.sleep(0)
        refused = asyncio.create_task(ask(limit, [701]))
        third = asyncio.create_task(ask(limit, [700]))
        await asyncio.sleep(0)
        assert app.read == [1000, 800, 700]
        app.may_answer.set()
        with pytest.raises(ServiceBusy):
            await refused
        await asyncio.gather(second, third)

    asyncio.run(story())
