"""A store's jobs for tests: a table, a spool, and runners that run any function."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gapmes.service.cameras.camera import Camera
from gapmes.service.cameras.pose import Given
from gapmes.service.jobs.leases import Lease
from gapmes.service.jobs.rows import Job
from gapmes.service.jobs.runner import Compute, Runner
from gapmes.service.jobs.spool import Spool
from gapmes.service.jobs.table import JobTable
from gapmes.service.jobs.work import Work
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.scenes.database import Database

A, B = "a" * 32, "b" * 32
WHY = {"code": "job_abandoned", "status": 500}


def work(seed: int = 0) -> Work:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, 3] = rng.normal(size=3)
    given = Given(1e-5, 0.25, 2.0**-26, "COLMAP", "opencv", "w2c")
    cameras = tuple(Camera(64, 48, 60.1, 60.2, 32.3, 24.4, pose, given) for _ in range(2))
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

    def ended(self, job_id: str = "1", seconds: float = 120.0) -> Job:
        return self.until(lambda job: job.over, job_id, seconds)

    def until(self, reached: Callable[[Job], bool], job_id: str = "1", seconds: float = 120.0) -> Job:
        deadline = time.monotonic() + seconds
        while not reached(job := self.table.get(job_id)):
            assert time.monotonic() < deadline, job
            time.sleep(0.005)
        return job


def states(table: JobTable, job_id: str) -> list[str]:
    return [event.data["state"] for event in table.events(job_id) if event.name == "state"]
