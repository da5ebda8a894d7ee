"""Killed processes: their jobs are taken over, and requests that waited there count no more."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from full_disk import full_disk
from job_place import A, Place
from open_files import open_below

from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.runner import Runner
from gapmes.service.jobs.work import Work
from gapmes.service.progress import Listener, Stage

CHILD = """
import sys, time
from pathlib import Path
from gapmes.service.scenes.database import Database
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
from gapmes.service.scenes.database import Database
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


@pytest.mark.parametrize("left", [b"", b"["])
def test_a_job_whose_left_end_cannot_be_read_ends(place: Place, left: bytes) -> None:
    """As a power cut may leave it; whoever waits must hear of an end."""
    (place.root / "jobs" / "1").mkdir(parents=True)
    (place.root / "jobs" / "1" / "end.json").write_bytes(left)
    place.table.submit("1", A)
    place.runner(lambda *_: None)
    assert place.ended(seconds=20.0).state == "failed"


def test_slots_of_the_living_count_together(tmp_path: Path) -> None:
    one, two = Lease(tmp_path, 3), Lease(tmp_path, 2)
    (tmp_path / "dead").write_text("5")
    assert (one.slots(), two.slots()) == (5, 5)
    three = Lease(tmp_path)
    (tmp_path / three.name).write_text("")  # as one of an earlier release
    assert one.slots() == 6
    two.release()
    assert one.slots() == 4


def test_a_process_that_starts_on_a_full_disk_counts_as_one_slot(tmp_path: Path) -> None:
    with full_disk(0):
        full = Lease(tmp_path, 3)
    other = Lease(tmp_path, 2)
    assert other.slots() == 3
    assert other.gone([full.name]) == set()


def test_the_living_are_not_taken_for_dead(tmp_path: Path) -> None:
    one, two = Lease(tmp_path), Lease(tmp_path)
    assert one.gone([one.name, two.name, "never"]) == {"never"}
    two.release()
    assert one.gone([one.name, two.name]) == {two.name}
    (tmp_path / "dead").touch()  # as a process leaves it that was killed
    three = Lease(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {one.name, three.name}


def test_processes_whose_files_were_deleted_are_still_alive(tmp_path: Path) -> None:
    """Each makes its own again when it looks, or tells of its progress; until then none takes the jobs of another."""
    folder = tmp_path / "leases"
    one, two = Lease(folder, 1), Lease(folder, 2)
    for _ in range(2):
        shutil.rmtree(folder)
        assert one.gone([two.name]) == set()
        assert not two.keep()
        assert two.keep()
        assert one.gone([two.name, "dead"]) == {"dead"}
        assert (one.slots(), two.slots()) == (3, 3)
    assert open_below(folder) == 2  # those of the deleted files are closed
    two.release()
    assert two.keep()  # it has ended, and stays so
    assert one.gone([two.name]) == {two.name}
    assert one.slots() == 1


def test_a_job_that_is_computed_keeps_the_file_of_its_process(place: Place) -> None:
    folder = place.root / "leases"

    def compute(_: Work, __: str, listener: Listener) -> None:
        shutil.rmtree(folder)
        listener(Stage("match", 0, 1, None))
        assert len(list(folder.iterdir())) == 1

    place.submit()
    place.runner(compute)
    assert place.ended().state == "done"
