"""Uvicorn's supervisor of worker processes, made to notice dead workers and signals at once."""

from __future__ import annotations

import importlib
import logging
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
LOOK_S = 0.2  # between checks for a signal while waiting for the answer to a ping
EXIT_S = 1.0  # from the end of a worker's pipe to its own
_log = logging.getLogger("gapmes")


class LockFreeEvent:
    """A replacement for `threading.Event` without a lock, which a signal handler could find held by the thread that it
    interrupts."""

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        self._is_set = True

    def is_set(self) -> bool:
        return self._is_set

    def wait(self, timeout: float) -> bool:
        """Sleep for `timeout` seconds unless it is set; returns whether it is."""
        if not self._is_set:
            time.sleep(timeout)
        return self._is_set


class WatchedProcess(multiprocess.Process):
    """A worker that the supervisor pings through a pipe; one that is just starting has a minute to answer.

    The supervisor must close its copy of the worker's end of the pipe: otherwise it would not notice the death of a
    worker until that minute is over, and replace no other meanwhile.
    """

    def __init__(self, config: Config, sockets: list[socket], ending: LockFreeEvent | None = None) -> None:
        """`ending` is set when the supervisor is to end."""
        super().__init__(config, sockets)
        self._ending = ending or LockFreeEvent()

    def start(self) -> None:
        """Start the worker, and close its end of the pipe here."""
        super().start()
        self.child_conn.close()

    def ping(self, timeout: float = 5) -> bool:
        """Whether the worker answers within `timeout` seconds. If the supervisor is to end meanwhile, it counts as
        alive, so that it is terminated like the others."""
        deadline = time.monotonic() + timeout
        try:
            self.parent_conn.send(b"ping")
            while not self.parent_conn.poll(max(0.0, min(LOOK_S, deadline - time.monotonic()))):
                if self._ending.is_set():
                    return True
                if time.monotonic() > deadline:
                    return False
            self.parent_conn.recv()
        except (OSError, EOFError, pickle.UnpicklingError):
            return False
        return True

    def is_alive(self, timeout: float = 5) -> bool:
        """As uvicorn's. A death is told as a warning, with its cause: uvicorn's own line is an info without."""
        alive = super().is_alive(timeout)
        if not alive and not self._ending.is_set():
            self.process.join(EXIT_S)
            _log.warning("worker process %s %s; another takes its place", self.pid, _end_of(self.exitcode))
        return alive


def _end_of(exitcode: int | None) -> str:
    if exitcode is None:
        return "does not answer"
    if exitcode >= 0:
        return f"ended with status {exitcode}"
    number = -exitcode
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return f"was ended by {name}{', as for lack of memory' if number == signal.SIGKILL else ''}"


class Watcher(multiprocess.Multiprocess):
    """A supervisor that forwards a signal to its workers at once. Uvicorn's own handles signals between checks of the
    workers, each of which may take a minute while one is replaced."""

    def __init__(self, config: Config, sockets: list[socket]) -> None:
        super().__init__(config, sockets)
        self.should_exit: Any = LockFreeEvent()
        self._made: list[multiprocess.Process] = []  # running workers; uvicorn lists one only once it is ready
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
    """Make uvicorn use this supervisor."""
    importlib.import_module("uvicorn.main").Multiprocess = Watcher  # type: ignore[attr-defined]
