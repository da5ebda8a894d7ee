"""The process that supervises workers notices at once when one ends, and a signal to end, whatever it is doing."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import uvicorn
from uvicorn.supervisors import multiprocess

from gapmes.service.process.watched_process import LockFreeEvent, WatchedProcess, Watcher

CONFIG = uvicorn.Config("gapmes.service.serving:app", factory=True, workers=2)


def asked_while_stopped(worker: WatchedProcess) -> tuple[list[bool], threading.Thread]:
    """A worker that cannot answer, and the thread that asks it for so long, with what it will have heard."""
    worker.start()
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGSTOP)
    heard: list[bool] = []
    asked = threading.Thread(target=lambda: heard.append(worker.ping(600)), daemon=True)
    asked.start()
    return heard, asked


def test_the_end_of_a_worker_that_has_not_answered_is_heard_of() -> None:
    """Not when the time to answer is over, which is long: until then nobody would hear a signal."""
    worker = WatchedProcess(CONFIG, [])
    heard, asked = asked_while_stopped(worker)
    os.kill(worker.pid, signal.SIGKILL)
    asked.join(120)
    worker.join()
    assert heard == [False]
    worker.kill()  # as the watcher does then


def test_a_worker_that_does_not_answer_keeps_nobody_from_ending() -> None:
    ending = LockFreeEvent()
    worker = WatchedProcess(CONFIG, [], ending)
    heard, asked = asked_while_stopped(worker)
    ending.set()
    asked.join(120)
    assert heard == [True]
    worker.kill()
    worker.join()


def test_a_death_is_a_warning_with_its_cause(caplog: pytest.LogCaptureFixture) -> None:
    """Also for who keeps only warnings: a worker may have been killed for lack of memory."""
    worker = WatchedProcess(CONFIG, [])
    worker.start()
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGKILL)
    assert not worker.is_alive(600)
    (told,) = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert told.getMessage() == (
        f"worker process {worker.pid} was ended by SIGKILL, as for lack of memory; another takes its place"
    )
    worker.kill()


class Worker:
    """One that is being replaced, or that is to take its place."""

    exitcode = None

    def __init__(self, *_: Any) -> None:
        self.pid = id(self)
        self.done: list[str] = []

    def start(self) -> None:
        self.done.append("start")

    def wait_until_ready(self, _: float, ending: LockFreeEvent) -> bool:
        heard = signal.getsignal(signal.SIGTERM)  # called, not raised: without a handler it would end the tests
        assert callable(heard)
        heard(signal.SIGTERM, None)
        return not ending.is_set()

    def kill(self) -> None:
        self.done.append("kill")

    def terminate(self) -> None:
        self.done.append("terminate")

    def join(self) -> None:
        self.done.append("join")


@pytest.fixture
def watcher(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watcher]:
    before = {number: signal.getsignal(number) for number in multiprocess.SIGNALS}
    monkeypatch.setattr(multiprocess, "Process", multiprocess.Process)  # so that it is what it was afterwards
    yield Watcher(CONFIG, [])
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_signal_to_end_is_heard_while_workers_are_replaced(watcher: Watcher, monkeypatch: pytest.MonkeyPatch) -> None:
    """The workers hear it at once, too: what one that is being replaced still has to do takes none of their time."""
    killed: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda *sent: killed.append(sent))
    monkeypatch.setattr(multiprocess, "Process", Worker)
    workers: Any = [Worker(), Worker()]
    watcher.processes = list(workers)
    watcher.restart_all()
    assert watcher.should_exit.is_set()
    assert watcher.processes == workers
    assert [worker.done for worker in workers] == [[], []]
    assert killed == [(worker.pid, signal.SIGTERM) for worker in workers]


def test_a_worker_that_takes_another_ones_place_hears_it_before_that_one_has_ended(
    watcher: Watcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library lists it only when the one before has ended, which may take that one's whole time."""
    killed: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda *sent: killed.append(sent))
    fresh: Any = Worker()
    watcher._made.append(fresh)
    watcher._end(signal.SIGTERM, None)
    assert (fresh.pid, signal.SIGTERM) in killed


def test_workers_are_known_from_the_beginning_until_they_have_ended(watcher: Watcher) -> None:
    worker: Any = multiprocess.Process(CONFIG, [])
    worker.start()
    assert watcher._made == [worker]
    worker.kill()
    worker.join()
    other: Any = multiprocess.Process(CONFIG, [])
    other.start()
    assert watcher._made == [other]
    other.kill()
    other.join()
