"""Work queues: whoever has the turn gets a thread, however many others have paused between steps."""

from __future__ import annotations

import threading
import time

import anyio
import pytest
from starlette.requests import ClientDisconnect

from gapmes.service.errors import ServiceBusy
from gapmes.service.http.concurrency import ConcurrencyLimit, Pause, WorkQueue

FILMS = 60  # more than the 40 worker threads that everybody shares


async def _stays() -> bool:
    return False


def _film(pause: Pause) -> int:
    for step in range(3):
        if step:
            pause()
        time.sleep(0.002)
    return 1


def test_films_that_pause_leave_a_thread_for_the_one_whose_turn_it_is() -> None:
    done: list[int] = []

    async def all_at_once() -> None:
        queue = WorkQueue("pictures", 1, 200, 600.0, "drawing")

        async def one() -> None:
            done.append(await queue.run_in_steps(_film, _stays))

        async with anyio.create_task_group() as tasks:
            for _ in range(FILMS):
                tasks.start_soon(one)

    anyio.run(all_at_once)
    assert len(done) == FILMS


def test_one_more_than_wait_is_refused() -> None:
    async def three() -> None:
        queue, over = WorkQueue("pictures", 1, 1, 600.0, "drawing"), threading.Event()

        async def hold() -> None:
            await queue.run(lambda: over.wait(600), _stays)

        async with anyio.create_task_group() as tasks:
            for _ in range(2):
                tasks.start_soon(hold)
            while queue.limit.taken < 2:
                await anyio.sleep(0.001)
            with pytest.raises(ServiceBusy, match="2 requests are drawing, the limit is 2"):
                await queue.run(lambda: None, _stays)
            over.set()

    anyio.run(three)


def test_a_single_one_is_counted_as_one() -> None:
    async def two() -> None:
        limit = ConcurrencyLimit("streams", 1, "following jobs")
        async with limit.slot():
            with pytest.raises(ServiceBusy, match="1 request is following jobs, the limit is 1"):
                limit.check()

    anyio.run(two)


def test_a_turn_that_comes_as_its_client_leaves_is_given_back() -> None:
    async def leaves_at_its_turn() -> None:
        queue = WorkQueue("pictures", 1, 4, 600.0, "drawing")
        await queue._turns.acquire()

        async def gone() -> bool:
            queue._turns.release()
            await anyio.sleep(0.01)  # the one that waits has its turn meanwhile
            return True

        with pytest.raises(ClientDisconnect):
            await queue.run(lambda: None, gone)
        assert not queue._turns.locked()

    anyio.run(leaves_at_its_turn)
