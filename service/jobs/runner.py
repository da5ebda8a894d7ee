"""Worker threads that claim jobs, compute them and record stages and ends, and queue jobs of dead processes again."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from ..errors import DeadlineExceeded, GapmesError, InputsGone, JobCancelled, StorageFull
from ..problem_document import problem, public
from ..process.logs import REQUEST_ID
from ..process.priority import give_way
from ..progress import Listener, Stage
from .leases import Lease
from .rows import Job
from .spool import Spool
from .table import JobTable
from .work import Work

POLL_S = 0.25  # between polls for jobs that other processes have queued
RECOVER_S = 2.0  # between checks for processes that have ended
STEP_S = 0.1  # between progress events within a stage; its beginning and end are always recorded
RETRY_S = 1.0  # between attempts to record the end of a job on a full disk

_log = logging.getLogger("gapmes")

Compute = Callable[[Work, str, Listener], None]  # work, scene id, listener of stages


class Runner:
    """Runs up to `slots` jobs at once, each in a thread of its own."""

    def __init__(
        self, table: JobTable, spool: Spool, lease: Lease, compute: Compute, *, slots: int, limit_s: float
    ) -> None:
        """A job that has run for more than `limit_s` seconds fails at its next report of progress."""
        self._table, self._spool, self._lease, self._compute = table, spool, lease, compute
        self._limit_s = limit_s
        self._wake = threading.Condition()
        self._stopping = self._draining = False
        self._looked = 0.0
        self._running: set[str] = set()
        self._threads = [threading.Thread(target=self._loop, name=f"job-{i}", daemon=True) for i in range(slots)]

    def start(self) -> None:
        """Start the threads."""
        for thread in self._threads:
            thread.start()

    def notify(self) -> None:
        """Wake a thread: this process has queued a job."""
        with self._wake:
            self._wake.notify()

    def drain(self) -> None:
        """From now on claim only jobs that a request waits for."""
        self._draining = True

    def stop(self, patience_s: float) -> None:
        """Claim no further jobs and wait up to `patience_s` for those that run. The rest are queued again, or ended if
        they were cancelled; where that cannot be noted, others take them up once the lease is released."""
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        deadline = time.monotonic() + patience_s
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(max(0.0, deadline - time.monotonic()))
        for job_id in list(self._running):
            try:
                over = self._table.give_back(job_id, self._lease.name)
            except Exception:  # such as a full disk, or an index that another program keeps locked
                _log.exception("that job %s is left cannot be noted", job_id)
                return
            if over:
                self._spool.drop(job_id)

    def recover(self) -> None:
        """Queue the jobs of processes that have ended again; a job whose process has ended twice fails."""
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
            except Exception:  # such as a full disk; queued jobs stay queued
                _log.exception("jobs cannot be claimed")
                time.sleep(RETRY_S)
                continue
            if job is None:
                with self._wake:
                    if not self._stopping:
                        self._wake.wait(POLL_S)
                continue
            self._running.add(job.id)
            token = REQUEST_ID.set(self._spool.request_id(job.id))  # for all log lines of the job
            try:
                self._run(job)
            except Exception:  # the thread must survive
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
        if left := self._spool.left_end(job.id):  # of a process that ended before it could record it
            over = self._noted(job, lambda: self._table.end(job.id, owner, *left))
        else:
            over = self._computed(job, owner)
        if over:
            self._spool.drop(job.id)

    def _computed(self, job: Job, owner: str) -> bool:
        """Compute the job and record its end; whether that was recorded."""
        problem_document: dict[str, Any] | None = None
        try:
            self._compute(self._inputs(job), job.scene_id, self._listener(job))
        except JobCancelled:
            return self._noted(job, lambda: self._table.end_cancelled(job.id, owner))
        except Exception as error:
            if not isinstance(error, GapmesError) or error.status == 500:
                _log.error("job %s failed", job.id, exc_info=error)
            problem_document = public(error)
        end = ("done" if problem_document is None else "failed", problem_document)
        return self._noted(
            job, lambda: self._table.end(job.id, owner, *end), lambda: self._spool.leave_end(job.id, *end)
        )

    def _inputs(self, job: Job) -> Work:
        try:
            return self._spool.get(job.id)
        except FileNotFoundError as error:
            raise InputsGone(
                "the job's photographs were deleted from the store before they were computed", cure="ask for it again"
            ) from error
        except (ValueError, KeyError, TypeError) as error:  # they are not synced to disk
            raise InputsGone(
                f"what was kept of the request cannot be read, as after a power cut: {error}", cure="ask for it again"
            ) from error

    def _noted(self, job: Job, note: Callable[[], bool], make_room: Callable[[], None] | None = None) -> bool:
        """Call `note` until it succeeds, or until the runner stops; returns what it does, False when stopping.

        On a full disk `make_room` is called before the next attempt, so that a job always ends.
        """
        while True:
            try:
                return note()
            except Exception as error:
                _log.exception("the end of job %s cannot be noted", job.id)
                if make_room is not None and isinstance(error, StorageFull):
                    make_room()
                    self._table.use_room()
                if self._stopping:
                    return False
                time.sleep(RETRY_S)

    def _listener(self, job: Job) -> Listener:
        """A listener that records progress as events, and ends the job by `JobCancelled` or `DeadlineExceeded`."""
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
            self._lease.keep()
            data = {"stage": stage.name, "done": stage.done, "total": stage.total}
            if stage.seconds is not None:
                data["seconds"] = round(stage.seconds, 6)
            if not self._table.stage(job.id, self._lease.name, data):
                raise JobCancelled("nobody wants the scene any more")

        return hear
