"""The threads that compute: every way in which a job ends, and processes that do not."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapmes.service.budget import Budget
from gapmes.service.camera import Camera
from gapmes.service.database import Database
from gapmes.service.errors import InputError, StorageFull
from gapmes.service.fade_passes import DEFAULT_PASSES
from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.rows import Job
from gapmes.service.jobs.runner import Compute, Runner
from gapmes.service.jobs.spool import Spool
from gapmes.service.jobs.table import JobTable
from gapmes.service.jobs.work import Work
from gapmes.service.pose import Given
from gapmes.service.progress import Stage, Stages

A = "a" * 32


def work(seed: int = 0) -> Work:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, 3] = rng.normal(size=3)
    cameras = tuple(Camera(64, 48, 60.1, 60.2, 32.3, 24.4, pose, Given(1e-5, 0.25, 2.0**-26)) for _ in range(2))
    return Work((b"one", b"two"), cameras, None, 7.5, True, 2, Budget(None, 3, ("1.5", "0"), 0.25, 2), "ds")


class Place:
    """A store's jobs, computed by a function."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.table = JobTable(Database(root / "index.sqlite"), most=20, keep_s=1e6)
        self.spool = Spool(root / "jobs")
        self.runners: list[Runner] = []

    def runner(self, compute: Compute, *, slots: int = 1, limit_s: float = 60.0) -> Runner:
        runner = Runner(self.table, self.spool, Lease(self.root / "leases"), compute, slots=slots, limit_s=limit_s)
        self.runners.append(runner)
        runner.start()
        return runner

    def submit(self, job_id: str = "1", scene_id: str = A, waits: str | None = None) -> Job:
        self.spool.put(job_id, work())
        return self.table.submit(job_id, scene_id, waits)

    def ended(self, job_id: str = "1", seconds: float = 20.0) -> Job:
        return self.until(lambda job: job.over, job_id, seconds)

    def until(self, reached: Callable[[Job], bool], job_id: str = "1", seconds: float = 20.0) -> Job:
        deadline = time.monotonic() + seconds
        while not reached(job := self.table.get(job_id)):
            assert time.monotonic() < deadline, job
            time.sleep(0.005)
        return job


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    place = Place(tmp_path)
    yield place
    for runner in place.runners:
        runner.stop(5.0)


def test_work_comes_back_from_disk_to_the_bit(tmp_path: Path) -> None:
    given, spool = work(), Spool(tmp_path / "jobs")
    spool.put("1", given)
    found = spool.get("1")
    assert found.document() == given.document()
    assert found.images == given.images
    assert found.budget == given.budget
    assert found.scene_id("model") == given.scene_id("model")
    for one, two in zip(found.cameras, given.cameras, strict=True):
        assert one.world_from_cam.tobytes() == two.world_from_cam.tobytes()
        assert one.given == two.given
    assert found.model == given.model
    spool.drop("1")
    with pytest.raises(FileNotFoundError):
        spool.get("1")


def test_work_of_a_release_with_one_model_is_for_the_default_one() -> None:
    document = replace(work(), fade=5).document()
    assert Work.of_document(document, [b"one", b"two"]).fade == 5
    assert document.pop("fade") == 5
    assert Work.of_document(document, [b"one", b"two"]).fade == DEFAULT_PASSES
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
    """It goes a moment after the end is noted."""
    deadline = time.monotonic() + 10
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
    assert place.ended().problem["code"] == "internal_error"


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

    def compute(_: Work, scene_id: str, __: object) -> None:
        nonlocal running, most
        with lock:
            order.append(scene_id)
            running += 1
            most = max(most, running)
        time.sleep(0.03)
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
    started.wait(10)
    runner.stop(10.0)
    assert place.table.get("1").state == "done"
    assert place.table.get("2").state == "queued"


def test_stopping_leaves_what_takes_too_long_to_another(place: Place) -> None:
    going = threading.Event()
    runner = place.runner(lambda *_: going.wait(20))
    place.submit()
    place.until(lambda job: job.state == "running")
    runner.stop(0.05)
    job = place.table.get("1")
    assert (job.state, job.attempts) == ("queued", 0)
    assert place.spool.get("1").images == (b"one", b"two")
    place.runner(lambda *_: None)
    assert place.ended().state == "done"
    going.set()
    time.sleep(0.1)
    assert place.table.get("1").state == "done"  # the first process has no say any more


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


CHILD = """
import sys, time
from pathlib import Path
from gapmes.service.database import Database
from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.runner import Runner
from gapmes.service.jobs.spool import Spool
from gapmes.service.jobs.table import JobTable
root = Path(sys.argv[1])
table = JobTable(Database(root / "index.sqlite"), most=20, keep_s=1e6)
Runner(table, Spool(root / "jobs"), Lease(root / "leases"), lambda *_: time.sleep(60), slots=1, limit_s=60).start()
time.sleep(60)
"""


def killed(place: Place) -> None:
    """A process that claims the job and is killed while it computes."""
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(place.root)])
    try:
        place.until(lambda job: job.state == "running")
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()


def test_a_job_whose_process_was_killed_is_taken_over(place: Place) -> None:
    place.submit()
    killed(place)
    assert place.table.get("1").state == "running"  # nobody has looked yet
    place.runner(lambda *_: None)
    job = place.ended()
    assert (job.state, job.attempts) == ("done", 2)
    reasons = [event.data.get("reason") for event in place.table.events("1")]
    assert "the process that computed it ended unexpectedly" in reasons


def test_a_job_that_kills_its_process_twice_fails_with_the_reason(place: Place) -> None:
    place.submit()
    killed(place)
    watcher = Runner(place.table, place.spool, Lease(place.root / "leases"), lambda *_: None, slots=1, limit_s=60.0)
    watcher.recover()
    assert place.table.get("1").state == "queued"
    killed(place)
    watcher.recover()
    job = place.table.get("1")
    assert (job.state, job.problem["code"]) == ("failed", "job_abandoned")


WAITS = """
import sys, time
from pathlib import Path
from gapmes.service.database import Database
from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.table import JobTable
root = Path(sys.argv[1])
lease = Lease(root / "leases")
JobTable(Database(root / "index.sqlite"), most=20, keep_s=1e6).join(sys.argv[2], lease.name)
time.sleep(60)
"""


def test_requests_of_a_killed_process_wait_no_more(place: Place) -> None:
    """Were they counted for ever, the job could not be cancelled."""
    place.submit()
    watcher = Runner(place.table, place.spool, Lease(place.root / "leases"), lambda *_: None, slots=1, limit_s=60.0)
    child = subprocess.Popen([sys.executable, "-c", WAITS, str(place.root), A])
    try:
        place.until(lambda job: job.waiting == 1)
        watcher.recover()
        assert place.table.cancel("1").state == "queued"  # the child lives, and waits
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    watcher.recover()
    assert (place.table.get("1").state, place.table.get("1").waiting) == ("queued", 0)
    assert place.table.cancel("1").state == "cancelled"


def test_the_living_are_not_taken_for_dead(tmp_path: Path) -> None:
    one, two = Lease(tmp_path), Lease(tmp_path)
    assert one.gone([one.name, two.name, "never"]) == {"never"}
    two.release()
    assert one.gone([one.name, two.name]) == {two.name}
    (tmp_path / "dead").touch()  # as a process leaves it that was killed
    three = Lease(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {one.name, three.name}
