"""Where reconstructions are asked for: each scene is computed once, however many ask for it at once."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from .. import metrics
from ..errors import ModelChanged, StorageFull
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


class Desk:
    """Jobs of one store; its runner computes them once there is a model."""

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
        """Begin to compute, what an earlier process left first; nothing where it was closed meanwhile."""
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
            except StorageFull:  # what is there can be drawn and deleted, and then this is done in time
                _log.exception("the store cannot be tidied")
            self._runner.start()

    def _compute_with(self, models: Models) -> Compute:
        store, settings = self._store, self._settings

        def scene(work: Work, scene_id: str, listener: Listener) -> None:
            if store.listed(scene_id):  # it was finished just before its process ended
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

            # before the model is loaded, which takes seconds and may take another's place
            if work.scene_id(models.get(work.model).identity) != scene_id:
                changed = "the job was asked for with another model file, engine or release"
                raise ModelChanged(changed, cure="ask for it again")
            with _told(models, work.model, hear) as reconstructor:
                metrics.reconstructed(compute(work, scene_id, reconstructor, store, settings, hear))
            trim()  # the scene itself is free by now

        return scene

    @property
    def _process(self) -> str:
        """Its name for the others; that of a process that is gone where this one has closed before it opened."""
        return "closed" if self._lease is None else self._lease.name

    def _slots(self) -> int:
        """Jobs that all processes of the store compute at a time; those that share this one's port count before they
        are loaded."""
        own = self._settings.workers * self._settings.concurrency
        return own if self._lease is None else max(own, self._lease.slots())

    def tidy(self) -> None:
        """Forget what ended long ago, and inputs that no job needs."""
        self.table.forget()
        self._spool.sweep(self.table.unfinished())

    def drain(self) -> None:
        """The process was told to end: begin nothing but what a request waits for."""
        self.draining = True
        if self._runner is not None:
            self._runner.drain()

    def close(self, patience_s: float) -> None:
        """End after what is being computed; what takes longer is left to another process."""
        with self._opening:
            self._closed = True
            if self._runner is not None and self._lease is not None:
                self._runner.stop(patience_s)
                self._lease.release()

    def leave(self, job_id: str, *, goes_on: bool = False) -> None:
        """A request does not wait any more; what nobody wants ends, and its inputs go, unless it `goes_on`."""
        if self.table.leave(job_id, self._process, goes_on=goes_on):
            self._spool.drop(job_id)

    def cancel(self, job_id: str) -> Job:
        """Nobody asks for the job any more. Raises `JobNotFound`."""
        job = self.table.cancel(job_id)
        if job.over:
            self._spool.drop(job_id)
        return job

    def submit(self, work: Work, scene_id: str, *, kept: bool) -> tuple[Job, bool]:
        """The job of a scene, and whether it is new: the one that is active, another, or one that is done where the
        scene is stored.

        `kept`: it goes on when nobody waits; else the caller must `leave` it, or wait for its end. Raises
        `ServiceBusy` and `StorageFull`.
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
            if job is None or job.id != job_id:  # refused, or somebody else was faster
                self._spool.drop(job_id)
        if self._runner is not None:
            self._runner.notify()
        return job, job.id == job_id


@contextmanager
def _told(models: Models, name: str, hear: Listener) -> Iterator[Reconstructor]:
    """The model, in use for as long as the block lasts; a stage of the job where it has to be loaded first."""
    with ExitStack() as held:
        if models.loaded(name):
            yield held.enter_context(models.using(name))
            return
        with Stages(hear).stage("load model"):
            reconstructor = held.enter_context(models.using(name))
        yield reconstructor
