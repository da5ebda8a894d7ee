"""Jobs in the database when processes end: killed, stopped, draining, or presumed dead but still running."""

from __future__ import annotations

from job_place import WHY, A, B, states

from gapmes.service.jobs.table import JobTable


def test_jobs_of_the_dead_are_tried_once_more(table: JobTable) -> None:
    table.submit("1", A)
    for attempt in (1, 2):
        assert table.claim("dead").attempts == attempt
        table.recover(set(), WHY)
        assert table.get("1").state == "running"
        assert table.processes() == {"dead"}
        assert table.recover({"dead"}, WHY) == (set() if attempt == 1 else {"1"})
        assert table.get("1").state == ("queued" if attempt == 1 else "failed")
    assert table.get("1").problem == WHY
    assert states(table, "1") == ["queued", "running", "queued", "running", "failed"]
    table.submit("2", B)
    table.claim("dead")
    table.cancel("2")
    assert table.recover({"dead"}, WHY) == {"2"}
    assert table.get("2").state == "cancelled"


def test_requests_of_the_dead_wait_no_more(table: JobTable) -> None:
    """What they asked for goes on, and can be cancelled."""
    table.submit("1", A, "dead")
    table.submit("2", B, "dead")
    table.join(B, "web")
    assert table.claim("web").id == "1"
    assert table.cancel("1").state == "running"
    assert table.processes() == {"dead", "web"}
    assert table.recover({"dead"}, WHY) == set()
    assert [table.get(job_id).waiting for job_id in "12"] == [0, 1]
    assert table.stage("1", "web", {"stage": "x"})
    table.cancel("1")
    assert not table.stage("1", "web", {"stage": "x"})
    assert table.cancel("2").state == "queued"
    assert table.leave("2", "web")
    assert table.processes() == {"web"}


def test_a_job_that_its_own_process_waited_for_is_tried_once_more(table: JobTable) -> None:
    table.submit("1", A, "dead")
    table.claim("dead")
    assert table.recover({"dead"}, WHY) == set()
    assert (table.get("1").state, table.get("1").waiting) == ("queued", 0)
    assert table.claim("web").id == "1"


def test_what_is_given_back_does_not_count(table: JobTable) -> None:
    table.submit("1", A)
    for _ in range(4):
        assert table.claim("me").attempts == 1
        assert not table.give_back("1", "me")


def test_what_is_given_back_ends_where_it_was_cancelled(table: JobTable) -> None:
    """Nobody wants it; another process would load the model for it before it noticed."""
    table.submit("1", A)
    table.claim("me")
    table.cancel("1")
    assert table.give_back("1", "me")
    assert table.get("1").state == "cancelled"
    table.submit("2", A)
    table.claim("me")
    table.cancel("2")
    table.join(A, "web")
    assert not table.give_back("2", "me")  # somebody wants it again
    assert (table.get("2").state, table.get("2").cancelled) == ("queued", False)


def test_a_job_goes_on_without_its_request_where_the_process_ends(table: JobTable) -> None:
    table.submit("1", A, "web")
    table.submit("2", B, "web")
    assert table.claim("web").id == "1"
    for job_id in "12":
        assert not table.leave(job_id, "web", goes_on=True)
        assert (table.get(job_id).waiting, table.get(job_id).cancelled) == (0, False)
    assert table.stage("1", "web", {"stage": "x"})
    table.give_back("1", "web")
    assert [table.claim("other").id for _ in range(2)] == ["1", "2"]
    assert table.stage("1", "other", {"stage": "x"})
    assert table.cancel("2").cancelled


def test_only_the_owner_of_a_running_job_says_how_it_goes(table: JobTable) -> None:
    """A process that gave a job back, or was taken for dead, may still be at it."""
    table.submit("1", A)
    table.claim("first")
    table.give_back("1", "first")
    table.give_back("1", "first")
    assert table.claim("second").attempts == 1
    assert not table.stage("1", "first", {"stage": "x"})
    assert not table.end("1", "first", "failed", WHY)
    assert not table.end_cancelled("1", "first")
    table.give_back("1", "first")
    assert (table.get("1").state, table.get("1").owner) == ("running", "second")
    assert table.end("1", "second", "done")
    table.give_back("1", "second")
    assert table.get("1").state == "done"


def test_while_a_process_ends_it_takes_only_what_a_request_waits_for(table: JobTable) -> None:
    table.submit("1", A)
    table.submit("2", B, "web")
    assert table.claim("me", waited_for=True).id == "2"
    assert table.claim("me", waited_for=True) is None
    assert table.claim("me").id == "1"
