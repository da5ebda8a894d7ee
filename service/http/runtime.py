"""The state of a running service: settings, store, jobs, queues, and the models once the default one is loaded."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, asynccontextmanager, contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import anyio
import anyio.to_thread
from fastapi import Depends, Request
from uvicorn import Server

from ..errors import ModelNotReady
from ..jobs.job_service import JobService
from ..model_names import DEFAULT
from ..process.peers import FOLDER, Peers
from ..process.priority import give_way
from ..progress import Listener, Stages, silent
from ..scenes.store import SceneStore
from ..settings import Settings
from .concurrency import GLANCE_S, ConcurrencyLimit, WorkQueue
from .shutdown_deadline import ShutdownDeadline

if TYPE_CHECKING:
    from ..models import Models

_log = logging.getLogger("gapmes")
MODELS = ".models"  # beside the scenes, a folder that is writable and shared by all processes
RETRY_S = 30.0  # before a process that could not load ends, to be replaced
PROBES = 4  # of /readyz at once, on threads of their own: all others may wait where the store's index is locked
KNOWN_S = 2.0
TIDY_S = 60.0  # between evictions of old scenes and deletions of old jobs


class Runtime:
    """Built with the application; the lifespan runs the application inside `running`."""

    def __init__(self, settings: Settings, bars: AbstractContextManager[Listener] | None = None) -> None:
        self.settings = settings
        self._bars = bars or nullcontext(silent)
        self.store = SceneStore(
            settings.store,
            cache_bytes=settings.cache_bytes,
            max_bytes=settings.store_bytes,
            max_days=settings.store_days,
        )
        self.jobs = JobService(self.store, settings)
        limits = settings.render_concurrency, settings.render_waiting, settings.render_seconds
        self.pictures = WorkQueue("pictures", *limits, "drawing or waiting to")
        self.files = WorkQueue("files", *limits, "converting files or waiting to")
        self.looks = WorkQueue(  # one photograph at a time is in memory at full size
            "looks", 1, settings.max_uploads, settings.render_seconds, "having their photographs looked at"
        )
        self.streams = ConcurrencyLimit("streams", settings.max_streams, "following jobs")
        self.scenes = ConcurrencyLimit(
            "scenes", settings.concurrency + settings.max_waiting, "waiting for their scenes"
        )
        self.uploads = ConcurrencyLimit("uploads", settings.max_uploads, "sending their photographs")
        self.probes = anyio.CapacityLimiter(PROBES)
        self.peers = Peers(settings.workers, Path(os.environ[FOLDER]) if FOLDER in os.environ else None)
        self.shutdown_deadline = ShutdownDeadline()
        self.stage = "start"
        self._listening = False
        self._told: float | None = None  # monotonic time of the signal to end
        self._stages = Stages()
        self._loading: asyncio.Future[None] | None = None
        self._models: Models | None = None

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Load in the background and run the periodic tasks during the block. A failed load is logged and kept for
        /readyz.

        The server listens once the block is entered: at once, or, if other processes answer already, when it is loaded.
        """
        loader = ThreadPoolExecutor(1, "load", give_way)  # the network's threads inherit the priority of this one
        self._loading = asyncio.ensure_future(asyncio.get_running_loop().run_in_executor(loader, self._load))
        self._loading.add_done_callback(_log_failure)
        tasks = [
            asyncio.create_task(each())
            for each in (self._tidy, self._stay_known, self._end_if_failed, self._end_in_time)
        ]
        try:
            with self._told_to_stop():
                while not (self._models or self.stopping or self.peers.may_listen_unloaded):
                    await asyncio.sleep(GLANCE_S)
                self._listening = True
                yield
        finally:
            self.stop()
            self._loading.cancel()
            loader.shutdown(wait=False, cancel_futures=True)
            for task in tasks:
                task.cancel()
            passed = time.monotonic() - (self._told or 0.0)  # requests have used part of the time
            patience = max(1.0, self.settings.drain_seconds - passed)
            await anyio.to_thread.run_sync(self.jobs.close, patience)

    def stop(self) -> None:
        """Shutdown begins: streams end, and only jobs that a request waits for are claimed."""
        if self._told is None:
            self._told = time.monotonic()
            self.jobs.drain()

    @property
    def stopping(self) -> bool:
        """Whether shutdown has begun."""
        return self._told is not None

    @contextmanager
    def _told_to_stop(self) -> Iterator[None]:
        """Call `stop` on the server's signals, before the server waits for streams, which would not end otherwise."""
        if threading.current_thread() is not threading.main_thread():  # as in tests
            yield
            return
        before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

        def heard(number: int, frame: FrameType | None) -> None:
            self.stop()
            handler = before[signal.Signals(number)]
            if callable(handler):
                handler(number, frame)

        for number in before:
            signal.signal(number, heard)
        servers = [getattr(handler, "__self__", None) for handler in before.values()]
        if any(isinstance(server, Server) and server.should_exit for server in servers):  # a signal came before
            self.stop()
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    async def _tidy(self) -> None:
        """Evict old scenes and delete old jobs every `TIDY_S` seconds."""
        while True:
            for tidy in (self.store.evict_old, self.jobs.tidy):  # each, even if the other fails
                try:
                    await anyio.to_thread.run_sync(tidy)
                except Exception:
                    _log.exception("the store cannot be tidied")
            await asyncio.sleep(TIDY_S)

    async def _stay_known(self) -> None:
        """Announce this process to its peers again every `KNOWN_S` seconds, if what it has announced is gone."""
        while True:
            await asyncio.sleep(KNOWN_S)
            try:
                await anyio.to_thread.run_sync(self.peers.keep)
            except OSError:  # such as a full disk; what was announced may be there
                _log.exception("the processes of the service cannot share their numbers")

    async def _end_in_time(self) -> None:
        """Cancel the remaining requests `drain_seconds` after the signal to end."""
        while self._told is None or time.monotonic() - self._told < self.settings.drain_seconds:
            await asyncio.sleep(GLANCE_S)
        self.shutdown_deadline.end()

    async def _end_if_failed(self) -> None:
        """End a process that failed to load, while others are loaded, so that the server replaces it."""
        assert self._loading is not None
        await asyncio.wait({self._loading})
        while self.failure is not None:
            await asyncio.sleep(RETRY_S)
            if self.peers.living() and not self.stopping:
                _log.error("this process ends, another is tried in its place")
                (_terminate if self._listening else _quit)()
                return

    def _load(self) -> None:
        """Import the heavy libraries, load the model, compile or load the kernels."""
        with self._bars as listener:
            self._stages = Stages(listener)
            with self._timed("import"):
                from ..kernels import warm_up_with_notice
                from ..models import Models
            with self._timed("model"):
                models = Models(self.settings, prepare=self.settings.store / MODELS)
                with models.using(DEFAULT):  # further models are loaded on first use
                    pass
            with self._timed("kernels"):
                warm_up_with_notice()
        self.jobs.open(models)
        self._models = models
        self.peers.announce_loaded()
        self.stage = "ready"

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        self.stage = stage
        with self._stages.stage(stage):
            yield

    @property
    def timings(self) -> dict[str, float]:
        """Seconds per stage of loading."""
        return self._stages.timings

    @property
    def failure(self) -> BaseException | None:
        """The exception of a failed load; None while it runs and after success."""
        task = self._loading
        return task.exception() if task is not None and task.done() and not task.cancelled() else None

    @property
    def models(self) -> Models:
        """The models. Raises `ModelNotReady` until the default one is loaded and the kernels are compiled."""
        if self._models is not None:
            return self._models
        if self.failure is not None:
            hint = "; is GAPMES_MODEL right?" if self.stage == "model" else ""
            raise ModelNotReady(f"loading failed in stage {self.stage!r}", cure=f"the service's log says why{hint}")
        raise ModelNotReady(f"the service is starting, stage {self.stage!r}", cure="poll /readyz and retry")

    def require_ready(self) -> None:
        """Raises `ModelNotReady` until pictures can be drawn as well: the kernels are compiled after models are
        loaded."""
        _ = self.models


def _quit() -> None:
    """End at once: an orderly end would listen for a moment."""
    os._exit(1)


def _terminate() -> None:
    """End in order, after the answers that have begun."""
    os.kill(os.getpid(), signal.SIGTERM)


def _log_failure(task: asyncio.Future[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        _log.error("the service cannot become ready", exc_info=task.exception())


async def runtime_of(request: Request) -> Runtime:
    """The service's runtime. A coroutine, since the framework would run a function on a worker thread."""
    return request.app.state.runtime


RuntimeDep = Annotated[Runtime, Depends(runtime_of)]
