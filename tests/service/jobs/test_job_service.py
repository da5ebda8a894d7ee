"""The service while requests wait: which departures cancel a job, and which do not."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import pytest
from job_place import A, work
from starlette.requests import ClientDisconnect

from gapmes.service.errors import DeadlineExceeded, ServiceBusy
from gapmes.service.http.waiting import ended
from gapmes.service.jobs.job_service import LEASES, SPOOL, JobService
from gapmes.service.jobs.rows import Job
from gapmes.service.scenes.store import SceneStore
from gapmes.service.settings import Settings


@pytest.fixture
def service(tmp_path: Path) -> JobService:
    """A service without models, so that nothing is computed here."""
    return JobService(SceneStore(tmp_path), Settings(store=tmp_path))


async def _stays() -> bool:
    return False


async def wait_and_be_ended(service: JobService, job: Job) -> None:
    """A request waits for the job, and then the server cancels it."""
    task = asyncio.create_task(ended(service, job, 60.0, _stays))
    await asyncio.sleep(0.05)
    assert not task.done()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


@pytest.mark.parametrize("running", [False, True])
def test_a_process_that_ends_leaves_what_its_requests_wait_for_to_another(
    service: JobService, tmp_path: Path, running: bool
) -> None:
    job, _ = service.submit(work(), A, kept=False)
    if running:
        service.table.claim("this")
    service.drain()
    asyncio.run(wait_and_be_ended(service, job))
    service.table.give_back(job.id, "this")
    left = service.table.get(job.id)
    assert (left.state, left.waiting, left.cancelled, left.attempts) == ("queued", 0, False, 0)
    assert (tmp_path / SPOOL / job.id).is_dir()
    assert service.table.claim("other").id == job.id
    assert service.table.stage(job.id, "other", {"stage": "network"})


def test_another_process_of_the_store_brings_room_of_its_own(tmp_path: Path) -> None:
    """What the others compute takes no place from those that wait, however few may."""
    settings = Settings(store=tmp_path, max_waiting=0)
    services = [JobService(SceneStore(tmp_path), settings) for _ in range(2)]
    try:
        for service in services:
            service.drain()  # so that nothing is computed: no request waits
            service.open(cast(Any, None))
            service.table.check_room()
            assert service.submit(work(), f"{len(service.table.unfinished()):032x}", kept=True)[1]
        with pytest.raises(ServiceBusy, match="2 reconstructions are running or waiting, the limit is 2"):
            services[0].submit(work(), A, kept=True)
    finally:
        for service in services:
            service.close(1.0)
    assert len(services[0].table.unfinished()) == 2
    assert [path.name for path in (tmp_path / LEASES).iterdir()] == []  # to others, both have ended


def test_a_request_that_ends_alone_takes_its_job_along(service: JobService, tmp_path: Path) -> None:
    job, _ = service.submit(work(), A, kept=False)
    asyncio.run(wait_and_be_ended(service, job))
    assert service.table.get(job.id).state == "cancelled"
    assert not (tmp_path / SPOOL / job.id).exists()


def test_a_request_that_has_waited_long_enough_is_told_and_takes_its_job_along(service: JobService) -> None:
    job, _ = service.submit(work(), A, kept=False)
    with pytest.raises(DeadlineExceeded, match="the scene was not there within 0 s"):
        asyncio.run(ended(service, job, 0.0, cast(Any, None)))
    assert service.table.get(job.id).state == "cancelled"


def test_who_waits_for_a_job_that_has_ended_gets_it_at_once(
    service: JobService, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long it took, and whether the client is still there or not: nothing is left to cancel."""
    job, _ = service.submit(work(), A, kept=False)
    service.table.claim("this")
    service.table.end(job.id, "this", "done")
    monkeypatch.setattr(service, "leave", None)
    assert asyncio.run(ended(service, job, 0.0, cast(Any, None))).state == "done"


def test_a_client_that_goes_away_while_the_process_ends_takes_its_job_along(service: JobService) -> None:
    async def leaves() -> bool:
        return True

    job, _ = service.submit(work(), A, kept=False)
    service.drain()
    with pytest.raises(ClientDisconnect):
        asyncio.run(ended(service, job, 60.0, leaves))
    assert service.table.get(job.id).state == "cancelled"
