"""Jobs in the database: one active job per scene, claimed once, ended once, with any clients and any crash."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from job_place import WHY, A, B, states

from gapmes.service.errors import JobNotFound, ServiceBusy
from gapmes.service.jobs.rows import ACTIVE, ENDED
from gapmes.service.jobs.table import JobTable
from gapmes.service.metrics import OWN
from gapmes.service.scenes.database import Database


def counted() -> dict[str, float]:
    """Ended jobs by state, as in the metrics."""
    return {state: OWN.get_sample_value("gapmes_jobs_total", {"state": state}) or 0.0 for state in ENDED}


def test_from_queued_to_done(table: JobTable) -> None:
    job = table.submit("1", A)
    assert (job.id, job.state, job.kept, job.waiting) == ("1", "queued", True, 0)
    assert table.submit("2", B).id == "2"
    assert table.ahead(table.get("2")) == 1
    claimed = table.claim("me")
    assert claimed is not None
    assert (claimed.id, claimed.state, claimed.owner, claimed.attempts) == ("1", "running", "me", 1)
    assert table.stage("1", "me", {"stage": "network", "done": 0, "total": 1})
    table.end("1", "me", "done")
    assert not table.end("1", "me", "failed", WHY)  # one that ended stays as it is
    ended = table.get("1")
    assert ended.over
    assert ended.problem is None
    assert states(table, "1") == ["queued", "running", "done"]
    assert [event.seq for event in table.events("1")] == [1, 2, 3, 4]
    assert [event.seq for event in table.events("1", 2)] == [3, 4]
    assert table.claim("me").id == "2"
    assert table.claim("me") is None


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """The clock is two days fast until this is undone."""
    true = time.time
    monkeypatch.setattr(time, "time", lambda: true() + 2 * 86_400)
    return monkeypatch


def test_jobs_have_their_turn_in_the_order_of_asking_whatever_the_clock_says(
    table: JobTable, fast: pytest.MonkeyPatch
) -> None:
    table.submit("9", A)
    fast.undo()
    table.submit("1", B)
    assert (table.ahead(table.get("9")), table.ahead(table.get("1"))) == (0, 1)
    assert [table.claim("me").id for _ in range(2)] == ["9", "1"]


def test_a_job_that_ended_by_a_fast_clock_is_forgotten_in_its_time(tmp_path: Path, fast: pytest.MonkeyPatch) -> None:
    table = JobTable(Database(tmp_path / "index.sqlite"), most=5, keep_s=3600.0)
    table.submit("1", A)
    table.cancel("1")
    fast.undo()
    now = time.time()
    fast.setattr(time, "time", lambda: 1000.0)  # a clock that has not been set yet knows no better
    table.forget()
    assert table.get("1").ended > now + 86_400
    fast.setattr(time, "time", lambda: now)
    table.forget()
    assert table.get("1").ended == now
    fast.setattr(time, "time", lambda: now + 3601.0)
    table.forget()
    with pytest.raises(JobNotFound):
        table.get("1")


def test_a_scene_has_one_active_job(table: JobTable) -> None:
    first = table.submit("1", A, "web")
    again = table.submit("2", A)
    assert again.id == first.id == "1"
    assert (again.kept, again.waiting) == (True, 1)
    assert table.join(A, "web").waiting == 2
    assert table.join(B, "web") is None
    table.claim("me")
    table.end("1", "me", "done")
    assert table.submit("3", A, "web").id == "3"


def test_no_more_than_so_many(table: JobTable) -> None:
    for number in range(5):
        table.submit(str(number), f"{number:032x}")
    with pytest.raises(ServiceBusy, match="5 reconstructions are running or waiting, the limit is 5"):
        table.submit("5", A)
    with pytest.raises(ServiceBusy):
        table.check_room()
    assert table.submit("6", f"{0:032x}").id == "0"  # joining needs no room
    table.cancel("0")
    table.check_room()


def test_a_job_goes_when_nobody_wants_it(table: JobTable) -> None:
    table.submit("1", A, "web")
    table.join(A, "web")
    assert not table.leave("1", "web")
    assert table.get("1").state == "queued"
    assert table.leave("1", "web")
    assert table.get("1").state == "cancelled"
    table.submit("2", A)
    table.join(A, "web")
    assert table.cancel("2").state == "queued"  # somebody waits for it
    table.leave("2", "web")
    assert table.get("2").state == "cancelled"
    assert table.cancel("2").state == "cancelled"


def test_a_running_job_ends_after_its_stage_unless_somebody_wants_it_again(table: JobTable) -> None:
    table.submit("1", A)
    table.claim("me")
    assert table.cancel("1").state == "running"
    assert not table.stage("1", "me", {"stage": "x"})
    assert table.end_cancelled("1", "me")
    assert table.get("1").state == "cancelled"
    table.submit("2", A)
    table.claim("me")
    table.cancel("2")
    assert table.submit("3", A).id == "2"
    assert table.stage("2", "me", {"stage": "x"})
    assert not table.end_cancelled("2", "me")  # it had heard of the cancel before
    assert table.get("2").state == "queued"
    assert table.claim("me").attempts == 1


def test_a_request_leaves_for_itself_alone(table: JobTable) -> None:
    table.submit("1", A, "web")
    table.join(A, "web")
    table.join(A, "other")
    assert not table.leave("1", "stranger")
    assert table.get("1").waiting == 3
    assert not table.leave("1", "web")
    assert not table.leave("1", "other")
    assert table.get("1").waiting == 1
    assert table.leave("1", "web")


def test_every_end_is_counted_once(table: JobTable) -> None:
    before = counted()
    found: list[dict[str, float]] = []

    def note() -> None:
        found.append({state: value - before[state] for state, value in counted().items()})

    table.submit("queued", A)
    for _ in range(2):
        table.cancel("queued")
    note()
    table.submit("left", A, "web")
    for _ in range(2):
        table.leave("left", "web")
    note()
    table.already_done(A)
    note()
    table.submit("runs", A)
    table.claim("me")
    table.cancel("runs")
    for _ in range(2):
        table.end_cancelled("runs", "me")
    note()
    table.submit("gone", A)
    for _ in range(2):
        table.claim("dead")
        table.recover({"dead"}, WHY)
    table.submit("unwanted", B)
    table.claim("dead")
    table.cancel("unwanted")
    for _ in range(2):
        table.recover({"dead"}, WHY)
    note()
    table.submit("back", A)
    table.claim("me")
    table.give_back("back", "me")
    table.claim("me")
    table.cancel("back")
    for _ in range(2):
        table.give_back("back", "me")
    note()
    for state in ("done", "failed"):
        table.submit(state, A)
        table.claim("me")
        for _ in range(2):
            table.end(state, "me", state)
    note()
    assert [(one["done"], one["failed"], one["cancelled"]) for one in found] == [
        (0, 0, 1), (0, 0, 2), (1, 0, 2), (1, 0, 3), (1, 1, 4), (1, 1, 5), (2, 2, 5),
    ]  # fmt: skip


def test_ended_jobs_are_forgotten(tmp_path: Path) -> None:
    table = JobTable(Database(tmp_path / "index.sqlite"), most=5, keep_s=0.05)
    table.submit("1", A)
    table.cancel("1")
    time.sleep(0.1)
    table.submit("2", B)
    table.claim("me")
    table.end("2", "me", "done")
    with pytest.raises(JobNotFound, match="'1'"):
        table.get("1")
    assert table.events("1") == []
    assert table.get("2").state == "done"


def test_unknown_jobs(table: JobTable) -> None:
    for call in (table.get, table.cancel):
        with pytest.raises(JobNotFound) as caught:
            call("x" * 500)
        assert len(str(caught.value)) < 200


def test_a_scene_that_is_stored_is_a_job_that_is_done(table: JobTable) -> None:
    job = table.already_done(A)
    assert (job.state, job.started) == ("done", None)
    assert states(table, job.id) == ["done"]


def test_asking_for_a_stored_scene_again_adds_no_job(tmp_path: Path) -> None:
    """Unless the job that tells of it will soon be forgotten."""
    database = Database(tmp_path / "index.sqlite")
    table = JobTable(database, most=5, keep_s=100.0)
    first = table.already_done(A)
    assert {table.already_done(A).id for _ in range(20)} == {first.id}
    assert table.already_done(B).id != first.id
    with database.write() as connection:
        connection.execute("UPDATE jobs SET ended = ended - 60 WHERE id = ?", [first.id])
    second = table.already_done(A)
    assert second.id != first.id
    assert table.already_done(A).id == second.id
    assert len(database.rows("SELECT id FROM jobs")) == 3
    table.submit("3", A)  # its scene was deleted, and is made again
    table.claim("me")
    table.end("3", "me", "done")
    assert table.already_done(A).id == second.id


def test_many_claim_and_each_job_is_had_once(tmp_path: Path) -> None:
    """From threads with connections of their own, as processes have them."""
    table = JobTable(Database(tmp_path / "index.sqlite"), most=100, keep_s=100.0)
    for number in range(60):
        table.submit(str(number), f"{number:032x}")
    had: list[str] = []

    def work(owner: str) -> None:
        while (job := table.claim(owner)) is not None:
            had.append(job.id)
            table.stage(job.id, owner, {"stage": "x"})
            table.end(job.id, owner, "done")

    threads = [threading.Thread(target=work, args=(str(k),)) for k in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(had, key=int) == [str(number) for number in range(60)]
    assert table.counts() == {"queued": 0, "running": 0}


@pytest.mark.parametrize("seed", range(8))
def test_whatever_happens_a_job_ends_once_and_tells_it_in_order(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = JobTable(Database(tmp_path / "index.sqlite"), most=4, keep_s=1e6)
    known: set[str] = set()
    for step in range(300):
        scene, kept = f"{rng.integers(3):032x}", bool(rng.integers(2))
        some = str(rng.choice(sorted(known))) if known else None
        match rng.integers(7):
            case 0 | 1:
                try:
                    known.add(table.submit(str(step), scene, None if kept else str(rng.integers(3))).id)
                except ServiceBusy:
                    assert sum(table.counts().values()) >= 4
            case 2:
                table.claim(str(rng.integers(3)))
            case 3 if some:
                table.leave(some, str(rng.integers(3)))
            case 4 if some:
                table.cancel(some)
            case 5:
                table.recover({str(rng.integers(3))}, WHY)
            case 6 if some and table.get(some).state == "running":
                owner = str(rng.integers(3))
                own = table.get(some).owner == owner
                if table.stage(some, owner, {"stage": "x"}):
                    assert table.end(some, owner, "done") == own
                else:
                    table.end_cancelled(some, owner)
    for job in (table.get(job_id) for job_id in known):
        events = table.events(job.id)
        assert [event.seq for event in events] == list(range(1, len(events) + 1))
        told = states(table, job.id)
        assert told[0] == "queued"
        assert all(state in ACTIVE for state in told[:-1])
        assert told[-1] == job.state
        assert (job.ended is not None) == (job.state in ENDED)
        assert job.attempts <= 2
    scenes = [table.get(job_id).scene_id for job_id in table.unfinished()]
    assert len(scenes) == len(set(scenes))


def test_what_fills_the_slots_does_not_wait(tmp_path: Path) -> None:
    """So many may wait beside those that are computed."""
    table = JobTable(Database(tmp_path / "index.sqlite"), most=2, keep_s=100.0, slots=lambda: 3)
    for number in range(5):
        table.submit(str(number), f"{number:032x}")
    with pytest.raises(ServiceBusy, match="the limit is 5"):
        table.check_room()
