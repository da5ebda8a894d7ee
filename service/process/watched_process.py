"""Several workers and the process that watches them, which hears at once of a worker's end, and of a signal to end."""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import time
from contextlib import suppress
from socket import socket
from typing import Any

from uvicorn import Config
from uvicorn.supervisors import multiprocess

TO_END = (signal.SIGTERM, signal.SIGINT)
LOOK_S = 0.2  # between two looks whether the end was asked for, while a worker is asked whether it lives


class Told:
    """Whether the end was asked for: an event without a lock, which a signal's handler could find held by the very
    thread that it interrupts."""

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        self._is_set = True

    def is_set(self) -> bool:
        return self._is_set

    def wait(self, timeout: float) -> bool:
        """Sleep for that time, unless it was asked for already."""
        if not self._is_set:
            time.sleep(timeout)
        return self._is_set


class WatchedProcess(multiprocess.Process):
    """The watcher asks each worker through a pipe whether it lives, and waits a minute for one that is just starting.

    It must not hold the worker's end of the pipe as well: of one that dies meanwhile it would hear nothing for that
    minute, in which it replaces nobody.
    """

    def __init__(self, config: Config, sockets: list[socket], told: Told | None = None) -> None:
        """`told`: whether the watcher is to end."""
        super().__init__(config, sockets)
        self._told = told or Told()

    def start(self) -> None:
        """Start it, and leave its end of the pipe to it alone."""
        super().start()
        self.child_conn.close()

    def ping(self, timeout: float = 5) -> bool:
        """Whether it answers in that time; one that has not when the watcher is to end counts as alive, so that it is
        told to end as all are."""
        deadline = time.monotonic() + timeout
        try:
            self.parent_conn.send(b"ping")
            while not self.parent_conn.poll(max(0.0, min(LOOK_S, deadline - time.monotonic()))):
                if self._told.is_set():
                    return True
                if time.monotonic() > deadline:
                    return False
            self.parent_conn.recv()
        except (OSError, EOFError, pickle.UnpicklingError):
            return False
        return True


class Watcher(multiprocess.Multiprocess):
    """Replacing workers takes up to a minute each, in which the library lets signals wait: what is to end hears of it
    then, as do its workers, each of which has its time from that moment on."""

    def __init__(self, config: Config, sockets: list[socket]) -> None:
        super().__init__(config, sockets)
        self.should_exit: Any = Told()
        self._made: list[multiprocess.Process] = []  # and not ended; of which the library lists one once it is ready
        multiprocess.Process = self._make  # type: ignore[assignment,misc]
        for number in TO_END:
            signal.signal(number, self._end)

    def _make(self, config: Config, sockets: list[socket]) -> WatchedProcess:
        process = WatchedProcess(config, sockets, self.should_exit)
        self._made = [*(one for one in self._made if one.exitcode is None), process]
        return process

    def _end(self, *_: object) -> None:
        self.should_exit.set()
        for process in {id(one): one for one in (*self.processes, *self._made)}.values():
            with suppress(ProcessLookupError):
                if process.pid is not None and process.exitcode is None:
                    os.kill(process.pid, signal.SIGTERM)


def install() -> None:
    """Have the server watch its processes so."""
    importlib.import_module("uvicorn.main").Multiprocess = Watcher  # type: ignore[attr-defined]
