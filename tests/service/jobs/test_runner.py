"""The computing threads: every way in which a job ends, and processes that do not."""

from __future__ import annotations

import os
import sqlite3
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from job_place import A, Place, work

from gapmes.service.errors import InputError, StorageFull
from gapmes.service.jobs.spool import Spool
from gapmes.service.jobs.work import Work
from gapmes.service.mending.fade_passes import DEFAULT_PASSES
from gapmes.service.process.logs import REQUEST_ID
from gapmes.service.progress import Stage, Stages


def test_what_is_logged_of_a_job_has_the_id_of_its_request(place: Place) -> None:
    """Also in another process, where only the disk tells it."""
    heard: list[str | None] = []
    runner = place.runner(lambda *_: heard.append(REQUEST_ID.get()))
    for job_id, request_id in (("1", "mine"), ("2", None)):
        place.spool.put(job_id, work(), request_id)
        place.table.submit(job_id, A)
        runner.notify()
        place.ended(job_id)
    assert heard == ["mine", None]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities per thread")
def test_a_job_gives_way_to_requests(place: Place) -> None:
    """It runs at a lower priority than the threads that answer, so that pictures are drawn first."""
    found: list[int] = []
    place.runner(lambda *_: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    place.submit()
    place.ended()
    answering = os.getpriority(os.PRIO_PROCESS, os.getpid())
    assert found == [min(answering + 5, 19)]


def test_work_of_a_release_with_one_model_is_for_the_default_one() -> None:
    document = replace(work(), fade=5, detail=2).document()
    found = Work.of_document(document, [b"one", b"two"])
    assert (found.fade, found.detail) == (5, 2)
    assert (document.pop("fade"), document.pop("detail")) == (5, 2)
    found = Work.of_document(document, [b"one", b"two"])
    assert (found.fade, found.detail) == (DEFAULT_PASSES, 1)
    assert document.pop("model") == "ds"
    assert Work.of_document(document, [b"one", b"two"]).model == "default"


def test_what_belongs_to_no_job_is_swept_once_it_is_old(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    for name in ("old", "young", "active"):
        spool.put(name, work())
    for name in ("old", "active"):
        os.utime(tmp_path / name, (1, 1))
    spool.sweep({"active"})
    assert {path.name for path in tmp_path.iterdir()} == {"young", "active"}


def test_stages_are_told_as_they_happen(place: Place) -> None:
    def compute(given: Work, scene_id: str, listener: Callable[[Stage], None]) -> None:
        assert (given.images, scene_id) == ((b"one", b"two"), A)
        stages = Stages(listener)
        with stages.stage("network"):
            pass
        with stages.stage("many", 1000) as step:
            for done in range(1, 1001):
                step(done)

    place.submit()
    place.runner(compute)
    assert place.ended().state == "done"
    stages = [event.data for event in place.table.events("1") if event.name == "stage"]
    assert [(s["stage"], s["done"]) for s in stages if s["done"] in (0, s["total"])] == [
        ("network", 0), ("network", 1), ("many", 0), ("many", 1000), ("many", 1000),
    ]  # fmt: skip
    assert len(stages) < 100  # steps between are thinned out
    assert "seconds" in stages[-1]
    gone(place.root / "jobs" / "1")


def gone(path: Path) -> None:
    """Wait for its removal, shortly after the end is noted."""
    deadline = time.monotonic() + 120
    while path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.parametrize(
    ("error", "code", "status"),
    [
        (InputError("no", field="x", cure="y"), "invalid_input", 422),
        (StorageFull("no space"), "storage_full", 507),
        (MemoryError("secret"), "internal_error", 500),
        (FileNotFoundError("/secret"), "internal_error", 500),
    ],
)
def test_failures_are_problem_documents(place: Place, error: Exception, code: str, status: int) -> None:
    def compute(*_: object) -> None:
        raise error

    place.runner(compute)
    place.submit()
    job = place.ended()
    assert (job.state, job.problem["code"], job.problem["status"]) == ("failed", code, status)
    assert "secret" not in str(job.problem)


def test_inputs_that_are_gone_are_a_failure(place: Place) -> None:
    place.submit()
    place.spool.drop("1")
    place.runner(lambda *_: None)
    job = place.ended()
    assert (job.state, job.problem["code"], job.problem["status"]) == ("failed", "inputs_gone", 410)
    assert "were deleted from the store" in job.problem["detail"]
    assert job.problem["cure"] == "ask for it again"


def endless(_: Work, __: str, listener: Callable[[Stage], None]) -> None:
    for step in range(10_000):
        listener(Stage(f"step {step}", 1, 1, 0.0))
        time.sleep(0.01)


def test_a_running_job_can_be_cancelled(place: Place) -> None:
    place.runner(endless)
    place.submit()
    place.until(lambda job: job.state == "running")
    place.table.cancel("1")
    assert place.ended().state == "cancelled"


def test_a_running_job_that_takes_too_long_fails(place: Place) -> None:
    place.runner(endless, limit_s=0.1)
    place.submit()
    job = place.ended()
    assert (job.state, job.problem["code"]) == ("failed", "deadline_exceeded")


@pytest.mark.parametrize("slots", [1, 2])
def test_so_many_run_at_once_in_the_order_of_arrival(place: Place, slots: int) -> None:
    running, most, order, lock = 0, 0, [], threading.Lock()
    together = threading.Event()

    def compute(_: Work, scene_id: str, __: object) -> None:
        nonlocal running, most
        with lock:
            order.append(scene_id)
            running += 1
            most = max(most, running)
            if running == slots:
                together.set()
        assert together.wait(120)
        time.sleep(0.03)  # so that one more would be met
        with lock:
            running -= 1

    scenes = [f"{number:032x}" for number in range(8)]
    for number, scene_id in enumerate(scenes):
        place.submit(str(number), scene_id)
    place.runner(compute, slots=slots)
    for number in range(8):
        place.ended(str(number))
    assert most == slots
    assert sorted(order) == scenes
    if slots == 1:  # of two that begin at once either may come here first
        assert order == scenes


def test_stopping_waits_for_what_runs_and_leaves_the_rest(place: Place) -> None:
    started = threading.Event()

    def compute(*_: object) -> None:
        started.set()
        time.sleep(0.2)

    runner = place.runner(compute)
    place.submit("1")
    place.submit("2", "b" * 32)
    assert started.wait(120)
    runner.stop(10.0)
    assert place.table.get("1").state == "done"
    assert place.table.get("2").state == "queued"


def test_stopping_leaves_what_takes_too_long_to_another(place: Place) -> None:
    begun, going = threading.Event(), threading.Event()
    runner = place.runner(lambda *_: (begun.set(), going.wait(120)))
    place.submit()
    assert begun.wait(60)
    runner.stop(0.05)
    job = place.table.get("1")
    assert (job.state, job.attempts) == ("queued", 0)
    assert place.spool.get("1").images == (b"one", b"two")
    place.runner(lambda *_: None)
    assert place.ended().state == "done"
    going.set()
    time.sleep(0.1)
    assert place.table.get("1").state == "done"  # the first process has no say any more


def test_stopping_ends_what_was_cancelled_and_its_inputs_go(place: Place) -> None:
    begun, going = threading.Event(), threading.Event()
    runner = place.runner(lambda *_: (begun.set(), going.wait(120)))
    place.submit()
    assert begun.wait(60)
    place.table.cancel("1")
    runner.stop(0.05)
    assert place.table.get("1").state == "cancelled"
    assert not (place.root / "jobs" / "1").exists()
    going.set()


def test_a_thread_survives_whatever_happens_to_a_job(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    real, calls = place.spool.drop, []

    def broken(job_id: str) -> None:
        calls.append(job_id)
        if len(calls) == 1:
            raise RuntimeError("anything")
        real(job_id)

    monkeypatch.setattr(place.spool, "drop", broken)
    place.runner(lambda *_: None)
    place.submit("1")
    place.submit("2", "b" * 32)
    assert place.ended("2").state == "done"


def test_the_end_of_a_job_is_noted_even_if_the_disk_is_full_for_a_while(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gapmes.service.jobs.runner.RETRY_S", 0.01)
    real, calls = place.table.end, []

    def full(*arguments: Any) -> bool:
        calls.append(arguments)
        if len(calls) < 4:
            raise sqlite3.OperationalError("database or disk is full")
        return real(*arguments)

    monkeypatch.setattr(place.table, "end", full)
    place.runner(lambda *_: None)
    place.submit()
    assert place.ended().state == "done"
    assert len(calls) == 4


@pytest.mark.parametrize("wanted_again", [False, True])
def test_the_inputs_of_a_job_that_is_over_make_room_for_its_end(
    place: Place, monkeypatch: pytest.MonkeyPatch, wanted_again: bool
) -> None:
    """What somebody may want again keeps them, however full the disk is."""
    monkeypatch.setattr("gapmes.service.jobs.runner.RETRY_S", 0.01)
    name = "end_cancelled" if wanted_again else "end"
    real, there, used = getattr(place.table, name), [], []

    def inputs() -> bool:
        return (place.root / "jobs" / "1" / "work.json").exists()

    def full(*arguments: Any) -> bool:
        there.append(inputs())
        if len(there) < 3:
            raise StorageFull("no space for the index", field="store")
        return real(*arguments)

    monkeypatch.setattr(place.table, name, full)
    monkeypatch.setattr(place.table, "use_room", lambda: used.append(inputs()))
    place.runner(endless if wanted_again else lambda *_: None)
    place.submit()
    if wanted_again:
        place.until(lambda job: job.state == "running")
        place.table.cancel("1")
    assert place.ended().state == ("cancelled" if wanted_again else "done")
    assert there == [True, wanted_again, wanted_again]
    assert used == ([] if wanted_again else [False, False])  # at once, before the next write takes it


@pytest.mark.parametrize("fails", [False, True])
def test_an_end_that_could_not_be_noted_is_taken_over(
    place: Place, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    """With its inputs gone nobody can compute it again, and nobody has to."""
    monkeypatch.setattr("gapmes.service.jobs.runner.RETRY_S", 0.01)
    real, tried = place.table.end, []

    def full(*_: Any) -> bool:
        tried.append(None)
        raise StorageFull("no space for the index", field="store")

    def compute(*_: object) -> None:
        if fails:
            raise InputError("no", field="x", cure="y")

    monkeypatch.setattr(place.table, "end", full)
    first = place.runner(compute)
    place.submit()
    while len(tried) < 3:
        time.sleep(0.01)
    first.stop(5.0)
    first._lease.release()
    monkeypatch.setattr(place.table, "end", real)
    second = place.runner(lambda *_: pytest.fail("computed again"))
    job = place.ended()
    second.stop(5.0)
    assert job.state == ("failed" if fails else "done")
    assert (job.problem or {}).get("code") == ("invalid_input" if fails else None)
    assert not (place.root / "jobs" / "1").exists()
