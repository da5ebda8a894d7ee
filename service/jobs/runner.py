"""The threads of a process that compute jobs: claim, compute, tell every stage, end; and take over from the dead."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from ..errors import DeadlineExceeded, GapmesError, JobCancelled
from ..problem_document import problem, public
from ..process.logs import REQUEST_ID
from ..process.priority import give_way
from ..progress import Listener, Stage
from .leases import Lease
from .rows import Job
from .spool import Spool
from .table import JobTable
from .work import Work

POLL_S = 0.25  # between looks for what other processes have queued
RECOVER_S = 2.0  # between looks for processes that ended
STEP_S = 0.1  # between two notes of steps of a stage; its beginning and end are always noted
RETRY_S = 1.0  # between attempts to note the end of a job on a full disk

_log = logging.getLogger("gapmes")

Compute = Callable[[Work, str, Listener], None]  # work, scene id, listener of stages


class Runner:
    """`slots` jobs at a time, each by a thread of its own."""

    def __init__(
        self, table: JobTable, spool: Spool, lease: Lease, compute: Compute, *, slots: int, limit_s: float
    ) -> None:
        """A job that takes longer than `limit_s` is ended after the stage that it is in then."""
        self._table, self._spool, self._lease, self._compute = table, spool, lease, compute
        self._limit_s = limit_s
        self._wake = threading.Condition()
        self._stopping = self._draining = False
        self._looked = 0.0
        self._running: set[str] = set()
        self._threads = [threading.Thread(target=self._loop, name=f"job-{i}", daemon=True) for i in range(slots)]

    def start(self) -> None:
        """Begin to claim jobs."""
        for thread in self._threads:
            thread.start()

    def notify(self) -> None:
        """A job was queued here: do not wait for the next look."""
        with self._wake:
            self._wake.notify()

    def drain(self) -> None:
        """Claim only jobs whose answer a request waits for; the others are left to another process."""
        self._draining = True

    def stop(self, patience_s: float) -> None:
        """Claim no further job and wait for those that run; those that take longer are queued for another process, or
        end where they were cancelled."""
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        deadline = time.monotonic() + patience_s
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(max(0.0, deadline - time.monotonic()))
        for job_id in list(self._running):
            if self._table.give_back(job_id, self._lease.name):
                self._spool.drop(job_id)

    def recover(self) -> None:
        """Queue the jobs of processes that ended again, or fail those that have ended two."""
        why = problem(
            500,
            "job_abandoned",
            "the processes that computed it ended unexpectedly, twice",
            cure="the service's log may say why; was memory short?",
        )
        gone = self._lease.gone(self._table.processes())
        if gone:
            for job_id in self._table.recover(gone, why):
                self._spool.drop(job_id)

    def _loop(self) -> None:
        give_way()
        while not self._stopping:
            try:
                job = self._next()
            except Exception:  # such as a full disk: what is queued stays queued
                _log.exception("jobs cannot be claimed")
                time.sleep(RETRY_S)
                continue
            if job is None:
                with self._wake:
                    if not self._stopping:
                        self._wake.wait(POLL_S)
                continue
            self._running.add(job.id)
            token = REQUEST_ID.set(self._spool.request_id(job.id))  # of all that is logged of it
            try:
                self._run(job)
            except Exception:  # the thread must go on, whatever happened to one job
                _log.exception("job %s was left", job.id)
            finally:
                REQUEST_ID.reset(token)
                self._running.discard(job.id)

    def _next(self) -> Job | None:
        now = time.monotonic()
        if now - self._looked > RECOVER_S:
            self._looked = now
            self.recover()
        return self._table.claim(self._lease.name, waited_for=self._draining)

    def _run(self, job: Job) -> None:
        owner = self._lease.name
        try:
            work = self._spool.get(job.id)
            self._compute(work, job.scene_id, self._listener(job))
        except JobCancelled:
            over = self._noted(job, lambda: self._table.end_cancelled(job.id, owner))
        except Exception as error:
            if not isinstance(error, GapmesError) or error.status == 500:
                _log.error("job %s failed", job.id, exc_info=error)
            document = public(error)
            over = self._noted(job, lambda: self._table.end(job.id, owner, "failed", document))
        else:
            over = self._noted(job, lambda: self._table.end(job.id, owner, "done"))
        if over:
            self._spool.drop(job.id)

    def _noted(self, job: Job, note: Callable[[], bool]) -> bool:
        """A full disk cannot keep a job from ending: the note is tried until it is there, or this process ends."""
        while True:
            try:
                return note()
            except Exception:
                _log.exception("the end of job %s cannot be noted", job.id)
                if self._stopping:
                    return False
                time.sleep(RETRY_S)

    def _listener(self, job: Job) -> Listener:
        """Notes stages for whoever follows the job, and ends it between two where it should not go on."""
        noted = 0.0
        started = time.monotonic()

        def hear(stage: Stage) -> None:
            nonlocal noted
            now = time.monotonic()
            if now - started > self._limit_s:
                raise DeadlineExceeded(
                    f"the reconstruction took more than {self._limit_s:g} s, in stage {stage.name!r}",
                    cure="use fewer views, or raise GAPMES_RECONSTRUCT_SECONDS",
                )
            inner = 0 < stage.done < stage.total and stage.seconds is None
            if inner and now - noted < STEP_S:
                return
            noted = now
            data = {"stage": stage.name, "done": stage.done, "total": stage.total}
            if stage.seconds is not None:
                data["seconds"] = round(stage.seconds, 6)
            if not self._table.stage(job.id, self._lease.name, data):
                raise JobCancelled("nobody wants the scene any more")

        return hear
