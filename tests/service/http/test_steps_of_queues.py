"""A queue that works in steps: others have their turn between two, and it survives those that end early."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from starlette.requests import ClientDisconnect

from gapmes.service.errors import ServiceBusy
from gapmes.service.http.concurrency import WorkQueue


async def here() -> bool:
    return False


def test_others_come_between_two_steps() -> None:
    order: list[str] = []

    async def scenario() -> None:
        queue = WorkQueue("pictures", 1, 5, 9.0, "drawing")
        first = threading.Event()
        asked = threading.Event()

        def film_of_three(pause: Any) -> None:
            for number in range(3):
                order.append(f"frame {number}")
                first.set()
                asked.wait(120)
                pause()

        running = asyncio.create_task(queue.run_in_steps(film_of_three, here))
        while not first.is_set():
            await asyncio.sleep(0.001)
        pictures = [asyncio.create_task(queue.run(lambda: order.append("picture"), here)) for _ in range(2)]
        while queue.limit.taken < 3:
            await asyncio.sleep(0.001)
        asked.set()
        await asyncio.gather(running, *pictures)
        assert await queue.run(lambda: 7, here) == 7
        assert queue.limit.taken == 0

    asyncio.run(scenario())
    assert order == ["frame 0", "picture", "picture", "frame 1", "frame 2"]


@pytest.mark.parametrize("ending", [ClientDisconnect, ServiceBusy, ZeroDivisionError])
def test_a_queue_survives_steps_that_end_early(ending: type[Exception]) -> None:
    """At a pause because nobody waits, at a pause because others do not end, or by a fault of its own."""
    steps: list[int] = []

    async def scenario() -> None:
        queue = WorkQueue("pictures", 1, 5, 1.0, "drawing")
        release = threading.Event()
        begun = threading.Event()

        async def gone() -> bool:
            return ending is ClientDisconnect and len(steps) == 2

        def function(pause: Any) -> None:
            for number in range(5):
                steps.append(number)
                begun.set()
                if ending is ZeroDivisionError and number == 1:
                    raise ZeroDivisionError
                if ending is ServiceBusy and number == 0:
                    while queue.limit.taken < 2:
                        release.wait(0.001)
                    release.wait(0.02)
                pause()

        running = asyncio.create_task(queue.run_in_steps(function, gone))
        blocking = None
        if ending is ServiceBusy:
            while not begun.is_set():
                await asyncio.sleep(0.001)
            blocking = asyncio.create_task(queue.run(lambda: release.wait(120), here))
        with pytest.raises(ending):
            await running
        release.set()
        if blocking is not None:
            await blocking
        for _ in range(2):  # neither lost nor doubled
            assert await queue.run(lambda: 7, here) == 7
        assert queue.limit.taken == 0
        assert not queue._turns.locked()

    asyncio.run(scenario())
    assert len(steps) == (1 if ending is ServiceBusy else 2)
