"""Submitting, awaiting and cancelling reconstructions: concurrent requests for one scene share one job."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from .. import metrics
from ..errors import ModelChanged, ServiceBusy, StorageFull
from ..process.allocator import trim
from ..process.logs import REQUEST_ID
from ..progress import Listener, Stage, Stages
from ..scenes.store import SceneStore
from .leases import Lease
from .rows import Job
from .runner import Compute, Runner
from .spool import Spool
from .table import JobTable
from .work import Work, compute

if TYPE_CHECKING:
    from ..models import Models
    from ..reconstruct import Reconstructor
    from ..settings import Settings

_log = logging.getLogger("gapmes")
LEASES, SPOOL = ".processes", ".jobs"  # folders beside the scenes


class JobService:
    """The jobs of one store: submitted at any time, computed by its runner once `open` has given it the models."""

    def __init__(self, store: SceneStore, settings: Settings) -> None:
        self._store, self._settings = store, settings
        self.table = JobTable(
            store.database, most=settings.max_waiting, keep_s=settings.job_keep_seconds, slots=self._slots
        )
        self._spool = Spool(store.root / SPOOL)
        self._opening = threading.Lock()
        self._closed = False
        self.draining = False  # the process was told to end
        self._lease: Lease | None = None
        self._runner: Runner | None = None

    def open(self, models: Models) -> None:
        """Start the runner, after jobs of processes that ended have been queued again. Does nothing after `close`."""
        with self._opening:
            if self._closed:
                return
            self._lease = Lease(self._store.root / LEASES, self._settings.concurrency)
            self._runner = Runner(
                self.table,
                self._spool,
                self._lease,
                self._compute_with(models),
                slots=self._settings.concurrency,
                limit_s=self._settings.reconstruct_seconds,
            )
            if self.draining:  # while the model was loaded
                self._runner.drain()
            try:
                self.tidy()
                self._runner.recover()
            except (StorageFull, ServiceBusy):  # scenes can still be drawn and deleted; this is tried again later
                _log.exception("the store cannot be tidied")
            self._runner.start()

    def _compute_with(self, models: Models) -> Compute:
        store, settings = self._store, self._settings

        def scene(work: Work, scene_id: str, listener: Listener) -> None:
            if store.listed(scene_id):  # its process ended after it had stored the scene, and before it noted the end
                return
            if work.model not in models.names:
                raise ModelChanged(
                    f"the job was asked for with the model {work.model!r}, which is not configured any more",
                    field="model",
                    cure=f"ask for it again with one of {', '.join(models.names)}",
                )

            def hear(stage: Stage) -> None:
                metrics.stage_ended(stage)
                listener(stage)

            # checked before the model is loaded, which takes seconds and may evict another one
            if work.scene_id(models.get(work.model).identity) != scene_id:
                changed = "the job was asked for with another model file, engine or release"
                raise ModelChanged(changed, cure="ask for it again")
            with _reporting_loads(models, work.model, hear) as reconstructor:
                metrics.reconstructed(compute(work, scene_id, reconstructor, store, settings, hear))
            trim()  # the scene is no longer referenced

        return scene

    @property
    def _process(self) -> str:
        """Name of this process's lease; before `open` a name that no living process has."""
        return "closed" if self._lease is None else self._lease.name

    def _slots(self) -> int:
        """Jobs that all processes of the store can run at once, including workers of this service that are not loaded
        yet."""
        own = self._settings.workers * self._settings.concurrency
        return own if self._lease is None else max(own, self._lease.slots())

    def tidy(self) -> None:
        """Delete the rows of jobs that ended long ago, and inputs of jobs that are not active."""
        self.table.forget()
        self._spool.sweep(self.table.unfinished())

    def drain(self) -> None:
        """Shutdown has begun: from now on claim only jobs that a request waits for."""
        self.draining = True
        if self._runner is not None:
            self._runner.drain()

    def close(self, patience_s: float) -> None:
        """Stop the runner and release the lease. Jobs that are not finished within `patience_s` are queued again."""
        with self._opening:
            self._closed = True
            if self._runner is not None and self._lease is not None:
                self._runner.stop(patience_s)
                self._lease.release()

    def leave(self, job_id: str, *, goes_on: bool = False) -> None:
        """A request stops waiting for a job. A job that nobody else wants is cancelled, unless it `goes_on`."""
        if self.table.leave(job_id, self._process, goes_on=goes_on):
            self._spool.drop(job_id)

    def cancel(self, job_id: str) -> Job:
        """Withdraw the request for a job, which ends unless other requests wait for its scene. Raises `JobNotFound`."""
        job = self.table.cancel(job_id)
        if job.over:
            self._spool.drop(job_id)
        return job

    def submit(self, work: Work, scene_id: str, *, kept: bool) -> tuple[Job, bool]:
        """The job of a scene, and whether it is new: the scene's active job if there is one, else a new one, which is
        done already if the scene is stored.

        A `kept` job runs to its end even if no request waits for it; for any other the caller must call `leave`, or
        wait for the end. Raises `ServiceBusy` and `StorageFull`.
        """
        if kept and self._store.exists(scene_id):
            return self.table.already_done(scene_id), True
        waits = None if kept else self._process
        there = self.table.join(scene_id, waits)
        if there is not None:
            return there, False
        self.table.check_room()
        job_id = uuid.uuid4().hex
        self._spool.put(job_id, work, REQUEST_ID.get())
        job = None
        try:
            job = self.table.submit(job_id, scene_id, waits)
        finally:
            if job is None or job.id != job_id:  # refused, or another request submitted the scene first
                self._spool.drop(job_id)
        if self._runner is not None:
            self._runner.notify()
        return job, job.id == job_id


@contextmanager
def _reporting_loads(models: Models, name: str, hear: Listener) -> Iterator[Reconstructor]:
    """The model, in use during the block. If it has to be loaded, that is reported as a stage of the job."""
    with ExitStack() as held:
        if models.loaded(name):
            yield held.enter_context(models.using(name))
            return
        with Stages(hear).stage("load model"):
            reconstructor = held.enter_context(models.using(name))
        yield reconstructor
